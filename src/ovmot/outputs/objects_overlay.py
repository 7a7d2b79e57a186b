"""The overlay that is drawn where nothing else is asked for: what moves, how fast, and where to.

Static points are small dots, dynamic ones arrows of their motion in the image; each object has its
3-D box with a cross on the side it moves towards, its path, id, class and speed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray, Image, IntArray
from ovmot.objects.motion_class import CLASSES
from ovmot.outputs import drawing, palette
from ovmot.outputs.trails import Trails, body_edges, moved_ways, seen_pieces
from ovmot.types import EgoEstimate, FrameResult, Health, ObjectTrack, PointLabel, StereoFrame

_LEAST_ARROW_PX = 6.0  # of the drawing: a shorter one would be a blot
_HEALTH: dict[Health, palette.Color] = {
    Health.TRACKING: palette.SKY_BLUE,
    Health.DEGRADED: palette.YELLOW,
    Health.LOST: palette.VERMILLION,
}


@dataclass(frozen=True, slots=True)
class ScenePicture:
    """What is drawn of one frame: N features and the tracks.

    `seconds` since the start of the run. `pixels`, `previous` (N, 2) are left pixels now and at
    the earlier frame of the comparison (NaN: not known), `label` and `track_id` (N,) as in
    `ScenePoints`. `T_cam0_world` (4, 4) maps points of the world into the left camera's frame.
    """

    seconds: float
    speed_mps: float
    health: Health
    standing: bool
    pixels: FloatArray
    previous: FloatArray
    label: IntArray
    track_id: IntArray
    tracks: tuple[ObjectTrack, ...]
    trails: Trails
    T_cam0_world: FloatArray
    camera: Camera


def scene_picture(result: FrameResult, camera: Camera, trails: Trails) -> ScenePicture:
    """What is drawn of a result; `trails` has been extended by it."""
    points, ego = result.points, result.ego
    return ScenePicture(
        trails.seconds(result.timestamp_ns), ego_speed(ego), ego.health, ego.standing,
        points.pixels[:, :2], points.previous, points.label, points.track_id, result.tracks, trails,
        se3.inverse(ego.T_world_imu @ ego.T_imu_cam0), camera,
    )  # fmt: skip


def ego_speed(ego: EgoEstimate) -> float:
    """Of the IMU, m/s; NaN where the odometry source does not know it."""
    return float(np.linalg.norm(ego.velocity))


def draw_objects(left: Image, scene: ScenePicture, width: int) -> Image:
    """The left image (height, width) with the scene, `width` pixels wide (BGR).

    The image may come in another size than the camera's.
    """
    image = drawing.backdrop(left, width / left.shape[1])
    scale = image.shape[1] / scene.camera.width
    _draw_points(image, scene, scale)
    draw_tracks(image, scene.tracks, scene.trails, scene.T_cam0_world, scene.camera, scale)
    drawing.caption(image, _caption(scene))
    return image


def draw_tracks(
    image: Image,
    tracks: Sequence[ObjectTrack],
    trails: Trails,
    T_cam0_world: FloatArray,
    camera: Camera,
    scale: float = 1.0,
) -> None:
    """Draw the confirmed tracks into an image `scale` times as large as the left image.

    What is behind the camera or beyond the camera model is cut off.
    """
    shown = [track for track in tracks if track.state == "confirmed"]
    wide = drawing.line_width(image)
    for track in shown:
        color = palette.color_of(track.track_id)
        trail = seen_pieces(moved_ways(trails.of(track.track_id)), T_cam0_world, camera)
        drawing.curves(image, trail, color, scale, wide)
        edges = seen_pieces(body_edges(track), T_cam0_world, camera)
        drawing.curves(image, edges, color, scale, wide)
    nearest = sorted(shown, key=lambda track: _distance(track, T_cam0_world))
    drawing.labels(
        image, np.array([track.box_px for track in nearest]).reshape(-1, 4),
        [track_words(track) for track in nearest],
        [palette.color_of(track.track_id) for track in nearest], scale,
    )  # fmt: skip


def track_words(track: ObjectTrack) -> str:
    """Id, class where it is known, and speed of a track."""
    words = [f"#{track.track_id}", class_word(track.class_probability)]
    words.append(f"{np.linalg.norm(track.velocity):.1f} m/s")
    return " ".join(word for word in words if word)


def class_word(probability: FloatArray) -> str:
    """The class of motion that is more probable than all others together; empty for none."""
    sure = np.flatnonzero(probability > 0.5)
    return CLASSES[sure[0]] if len(sure) else ""


def _draw_points(image: Image, scene: ScenePicture, scale: float) -> None:
    """Static points first: arrows are not to be covered by dots."""
    dynamic = scene.label == PointLabel.DYNAMIC
    radius = max(1, round(image.shape[1] / 900))
    drawing.dots(image, scene.pixels[~dynamic], palette.GREY, scale, radius)
    motion = scale * np.linalg.norm(scene.pixels - scene.previous, axis=1)
    arrows = dynamic & (motion >= _LEAST_ARROW_PX)
    for track_id in np.unique(scene.track_id[dynamic]).tolist():
        color = palette.WHITE if track_id < 0 else palette.color_of(track_id)
        mine = scene.track_id == track_id
        still = mine & dynamic & ~arrows
        drawing.dots(image, scene.pixels[still], color, scale, radius + 1)
        moving = mine & arrows
        drawing.arrows(image, scene.previous[moving], scene.pixels[moving], color, scale)


def _caption(scene: ScenePicture) -> list[tuple[str, palette.Color]]:
    n_objects = sum(track.state == "confirmed" for track in scene.tracks)
    n_dynamic = int(np.count_nonzero(scene.label == PointLabel.DYNAMIC))
    n_static = int(np.count_nonzero(scene.label == PointLabel.STATIC))
    words = [(f"{scene.seconds:.1f} s", palette.WHITE)]
    if scene.standing:
        words.append(("standing", palette.WHITE))
    elif np.isfinite(scene.speed_mps):
        words.append((f"{scene.speed_mps:.1f} m/s", palette.WHITE))
    words.append((str(scene.health), _HEALTH[scene.health]))
    words.append((f"{n_objects} object{'' if n_objects == 1 else 's'}", palette.WHITE))
    if len(scene.label):
        words.append((f"• {n_static} static", palette.GREY))
        words.append((f"→ {n_dynamic} dynamic", palette.WHITE))
    return words


def _distance(track: ObjectTrack, T_cam0_world: FloatArray) -> float:
    return float(np.linalg.norm(se3.apply(T_cam0_world, track.position)))


def left_image(result: FrameResult) -> Image | None:
    """The left image of a result, None where it was of features alone."""
    return result.frame.left if isinstance(result.frame, StereoFrame) else None
