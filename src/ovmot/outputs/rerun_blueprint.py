"""How Rerun's viewer is laid out for a run: the world beside the camera, plots below."""

from typing import Any

TIMELINE = "time"
"""Seconds since the first frame."""
WORLD, RIG, CAM0, CAM1 = "world", "world/rig", "world/rig/cam0", "world/rig/cam1"
PATH, BOXES, TRAILS = "world/path", "world/objects/boxes", "world/objects/trails"
STATIC, DYNAMIC = "world/points/static", "world/points/dynamic"
SPEED, SIGMA, STAGES, LOG = "plots/speed", "plots/sigma", "plots/ms", "log"


def run_blueprint() -> Any:
    """A blueprint of the SDK; the path is shown from the start to the time that is looked at."""
    import rerun.blueprint as rrb

    whole = rrb.VisibleTimeRanges(
        rrb.VisibleTimeRange(
            TIMELINE,
            start=rrb.TimeRangeBoundary.infinite(),
            end=rrb.TimeRangeBoundary.cursor_relative(),
        )
    )
    world = rrb.Spatial3DView(
        origin=f"/{WORLD}", name="world", overrides={f"/{PATH}": [whole]},
        contents=[f"+ /{WORLD}/**"],
    )  # fmt: skip
    camera = rrb.Spatial2DView(
        origin=f"/{CAM0}", name="left camera",
        contents=[f"+ /{CAM0}/**", f"+ /{BOXES}", f"+ /{DYNAMIC}"],
    )  # fmt: skip
    plots = [
        rrb.TimeSeriesView(origin=f"/{origin}", name=name)
        for origin, name in (
            (SPEED, "speeds, m/s"),
            (SIGMA, "1-sigma of position, m"),
            (STAGES, "stages, ms"),
        )
    ]
    log = rrb.TextLogView(origin=f"/{LOG}", name="health")
    right = rrb.Vertical(camera, rrb.Tabs(*plots, log), row_shares=[3, 2])
    return rrb.Blueprint(
        rrb.Horizontal(world, right, column_shares=[3, 2]),
        rrb.TimePanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )
