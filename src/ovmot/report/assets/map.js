"use strict";

const FOLLOW_M = 60; // of the width of a map that follows the rig
const WIDE_M = 150; // a path this long is followed at first
const TRAIL_S = 4;

/** The map from above: paths, trails and boxes at the clock's time. */
class MapView {
  constructor(canvas) {
    this.canvas = canvas;
    this.follow = false;
    this.center = [0, 0];
    this.scale = 1; // pixels of the screen a metre
    this.extent = extentOf(RUNS);
    new ResizeObserver(() => this.resized()).observe(canvas);
    this.listen();
  }

  resized() {
    const first = !this.width;
    this.width = this.canvas.clientWidth;
    this.height = this.canvas.clientHeight;
    const dense = window.devicePixelRatio || 1;
    this.canvas.width = Math.max(1, Math.round(this.width * dense));
    this.canvas.height = Math.max(1, Math.round(this.height * dense));
    this.dense = dense;
    if (first) {
      this.fit();
      const [x0, y0, x1, y1] = this.extent;
      if (Math.max(x1 - x0, y1 - y0) > WIDE_M) this.setFollow(true);
    }
    this.draw();
  }

  fit() {
    const [x0, y0, x1, y1] = this.extent;
    const margin = 1.12;
    const across = Math.max((x1 - x0) * margin, 4);
    const along = Math.max((y1 - y0) * margin, 4);
    this.center = [(x0 + x1) / 2, (y0 + y1) / 2];
    this.scale = Math.min(this.width / across, this.height / along);
    this.setFollow(false);
  }

  setFollow(follow) {
    this.follow = follow;
    document.getElementById("map-follow").setAttribute("aria-pressed", String(follow));
    if (follow) this.scale = Math.min(this.width, this.height * 1.4) / FOLLOW_M;
  }

  zoom(factor, at = [this.width / 2, this.height / 2]) {
    const before = this.toWorld(at);
    this.scale = Math.min(Math.max(this.scale * factor, 0.02), 400);
    if (!this.follow) {
      const after = this.toWorld(at);
      this.center = [this.center[0] + before[0] - after[0], this.center[1] + before[1] - after[1]];
    }
    this.draw();
  }

  toWorld([u, v]) {
    return [
      this.center[0] + (u - this.width / 2) / this.scale,
      this.center[1] - (v - this.height / 2) / this.scale,
    ];
  }

  u(x) {
    return this.width / 2 + (x - this.center[0]) * this.scale;
  }

  v(y) {
    return this.height / 2 - (y - this.center[1]) * this.scale;
  }

  listen() {
    const canvas = this.canvas;
    const fingers = new Map();
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = fingers.get(event.pointerId);
      if (!before) return;
      const now = [event.offsetX, event.offsetY];
      if (fingers.size === 1) this.pan(now[0] - before[0], now[1] - before[1]);
      else {
        const other = [...fingers].find(([id]) => id !== event.pointerId)[1];
        const apart = (a) => Math.max(Math.hypot(a[0] - other[0], a[1] - other[1]), 1);
        this.zoom(apart(now) / apart(before), other);
      }
      fingers.set(event.pointerId, now);
    });
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
    }
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY / 400), [event.offsetX, event.offsetY]);
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => this.key(event));
    const tools = {
      "map-in": () => this.zoom(1.4),
      "map-out": () => this.zoom(1 / 1.4),
      "map-fit": () => { this.fit(); this.draw(); },
      "map-follow": () => { this.setFollow(!this.follow); this.draw(); },
    };
    for (const [id, action] of Object.entries(tools)) {
      document.getElementById(id).addEventListener("click", action);
    }
  }

  key(event) {
    const step = 40;
    const actions = {
      "+": () => this.zoom(1.4), "=": () => this.zoom(1.4), "-": () => this.zoom(1 / 1.4),
      0: () => { this.fit(); this.draw(); },
      f: () => { this.setFollow(!this.follow); this.draw(); },
      ArrowUp: () => this.pan(0, step), ArrowDown: () => this.pan(0, -step),
      ArrowLeft: () => this.pan(step, 0), ArrowRight: () => this.pan(-step, 0),
    };
    if (!actions[event.key] || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    event.stopPropagation();
    actions[event.key]();
  }

  pan(du, dv) {
    if (this.follow) this.setFollow(false);
    this.center = [this.center[0] - du / this.scale, this.center[1] + dv / this.scale];
    this.draw();
  }

  draw() {
    if (!this.width) return;
    const pen = this.canvas.getContext("2d");
    pen.setTransform(this.dense, 0, 0, this.dense, 0, 0);
    pen.clearRect(0, 0, this.width, this.height);
    if (this.follow) {
      const ego = RUNS[0].ego;
      const i = lastUpTo(RUNS[0].t, clock.now);
      this.center = [ego.x[i], ego.y[i]];
    }
    this.drawGrid(pen);
    const truth = RUNS.find((run) => run.truth);
    if (truth) this.line(pen, truth.truth.x, truth.truth.y, css("--truth"), 5, 0.45);
    this.names = [];
    RUNS.forEach((run, i) => this.drawRun(pen, run, runColor(i)));
    if (truth) this.drawTrueObjects(pen, truth);
    this.drawNames(pen);
  }

  drawRun(pen, run, color) {
    const now = lastUpTo(run.t, clock.now);
    for (const track of run.tracks) {
      this.line(pen, track.x, track.y, trackColor(track.id), 1, 0.35);
    }
    for (const [first, last] of segmentsOf(run)) {
      this.line(pen, run.ego.x, run.ego.y, color, 1.5, 0.4, first, last);
      if (now >= first) {
        this.line(pen, run.ego.x, run.ego.y, color, 2.5, 1, first, Math.min(last, now));
      }
    }
    for (const track of run.tracks) this.drawTrack(pen, run, track, now);
    this.drawRig(pen, run, now, color);
  }

  /** Outline and trail of the true objects, thin and grey. */
  drawTrueObjects(pen, run) {
    const now = lastUpTo(run.t, clock.now);
    for (const object of run.truth.objects) this.drawBox(pen, run, object, now, css("--soft"), 1);
  }

  /** An object's trail and its box as it is now; its index and corners, or null if it is not seen. */
  drawBox(pen, run, object, now, color, width) {
    const k = lastUpTo(object.at, now);
    if (object.at[k] !== now) return null;
    let first = k;
    while (first > 0 && run.t[object.at[first - 1]] >= run.t[now] - TRAIL_S) first -= 1;
    this.line(pen, object.x, object.y, color, width, 1, first, k);
    const [c, s] = [Math.cos(object.yaw[k]), Math.sin(object.yaw[k])];
    const [l, w] = [object.length[k] / 2, object.width[k] / 2];
    const corner = (a, b) => [
      this.u(object.x[k] + c * a * l - s * b * w), this.v(object.y[k] + s * a * l + c * b * w),
    ];
    pen.strokeStyle = color;
    pen.lineWidth = width;
    pen.beginPath();
    for (const [a, b] of [[1, 1], [-1, 1], [-1, -1], [1, -1]]) pen.lineTo(...corner(a, b));
    pen.closePath();
    pen.stroke();
    return [k, corner];
  }

  drawTrack(pen, run, track, now) {
    const color = trackColor(track.id);
    const drawn = this.drawBox(pen, run, track, now, color, 2);
    if (!drawn) return;
    const [k, corner] = drawn;
    pen.fillStyle = color;
    pen.globalAlpha = 0.25;
    pen.fill();
    pen.globalAlpha = 1;
    pen.beginPath(); // a tip on the side it moves towards
    pen.moveTo(...corner(1, 0.6));
    pen.lineTo(...corner(1.5, 0));
    pen.lineTo(...corner(1, -0.6));
    pen.stroke();
    const kind = track.kind ? ` ${track.kind}` : "";
    const words = `#${track.id}${kind} ${shown(track.speed[k], 1)} m/s`;
    this.names.push([words, this.u(track.x[k]), this.v(track.y[k]), color]);
  }

  drawRig(pen, run, now, color) {
    const [u, v] = [this.u(run.ego.x[now]), this.v(run.ego.y[now])];
    const yaw = run.ego.yaw[now] ?? 0;
    pen.save();
    pen.translate(u, v);
    pen.rotate(-yaw);
    pen.fillStyle = color;
    pen.strokeStyle = css("--map");
    pen.lineWidth = 1.5;
    pen.beginPath();
    for (const [a, b] of [[11, 0], [-7, 7], [-3.5, 0], [-7, -7]]) pen.lineTo(a, b);
    pen.closePath();
    pen.fill();
    pen.stroke();
    pen.restore();
    if (SEVERAL) this.names.push([run.name, u, v, color]);
  }

  /** Names beside their things, none over another or over a thing: the nearest free line. */
  drawNames(pen) {
    pen.font = "12px system-ui, sans-serif";
    pen.textBaseline = "middle";
    const taken = this.names.map(([, u, v]) => [u - 14, u + 14, v]);
    for (const [words, u, v, color] of this.names) {
      if (u < -20 || v < -20 || u > this.width + 20 || v > this.height + 20) continue;
      const width = pen.measureText(words).width + 8;
      const left = u + 16 + width < this.width ? u + 16 : Math.max(u - 16 - width, 2);
      const places = [-12, 12, -28, 28, -44, 44, -60, 60, 76].map((dv) => v + dv);
      const free = places.find((y) => y > 8 && y < this.height - 8 && !taken.some(
        ([l, r, t]) => l < left + width && r > left && Math.abs(t - y) < 16));
      if (free === undefined) continue;
      taken.push([left, left + width, free]);
      pen.globalAlpha = 0.8;
      pen.fillStyle = css("--map");
      pen.fillRect(left, free - 8, width, 16);
      pen.globalAlpha = 1;
      pen.fillStyle = color;
      pen.fillText(words, left + 4, free);
    }
  }

  line(pen, x, y, color, width, alpha, first = 0, last = x.length - 1) {
    pen.strokeStyle = color;
    pen.lineWidth = width;
    pen.lineJoin = "round";
    pen.globalAlpha = alpha;
    pen.beginPath();
    for (let i = first; i <= last; i += 1) {
      if (x[i] !== null) pen.lineTo(this.u(x[i]), this.v(y[i]));
    }
    pen.stroke();
    pen.globalAlpha = 1;
  }

  drawGrid(pen) {
    const step = niceStep(90 / this.scale);
    const [x0, y1] = this.toWorld([0, 0]);
    const [x1, y0] = this.toWorld([this.width, this.height]);
    pen.strokeStyle = css("--grid");
    pen.lineWidth = 1;
    pen.beginPath();
    for (let x = Math.ceil(x0 / step) * step; x < x1; x += step) {
      pen.moveTo(this.u(x), 0);
      pen.lineTo(this.u(x), this.height);
    }
    for (let y = Math.ceil(y0 / step) * step; y < y1; y += step) {
      pen.moveTo(0, this.v(y));
      pen.lineTo(this.width, this.v(y));
    }
    pen.stroke();
    const bar = step * this.scale;
    const [u, v] = [12, this.height - 12];
    pen.strokeStyle = css("--soft");
    pen.fillStyle = css("--soft");
    pen.lineWidth = 2;
    pen.beginPath();
    for (const [a, b] of [[0, -5], [0, 0], [bar, 0], [bar, -5]]) pen.lineTo(u + a, v + b);
    pen.stroke();
    pen.font = "12px system-ui, sans-serif";
    pen.textBaseline = "bottom";
    pen.fillText(`${step} m`, u + 5, v - 3);
  }
}

/** The least and greatest x and y of paths, without far away tracks. */
function extentOf(runs) {
  const xs = runs.flatMap((run) => [...run.ego.x, ...(run.truth ? run.truth.x : [])]);
  const ys = runs.flatMap((run) => [...run.ego.y, ...(run.truth ? run.truth.y : [])]);
  const box = [least(xs), least(ys), -least(xs.map((x) => -x)), -least(ys.map((y) => -y))];
  const reach = 40;
  const wide = box.slice();
  for (const run of runs) {
    for (const track of run.tracks) {
      for (let i = 0; i < track.x.length; i += 1) {
        const [x, y] = [track.x[i], track.y[i]];
        if (x < box[0] - reach || x > box[2] + reach || y < box[1] - reach || y > box[3] + reach) continue;
        wide[0] = Math.min(wide[0], x);
        wide[1] = Math.min(wide[1], y);
        wide[2] = Math.max(wide[2], x);
        wide[3] = Math.max(wide[3], y);
      }
    }
  }
  return wide;
}

function least(numbers) {
  return numbers.reduce((a, b) => (b === null ? a : Math.min(a, b)), Infinity);
}

/** First and last index of each segment; between two of them the position may jump. */
function segmentsOf(run) {
  const out = [];
  let first = 0;
  for (let i = 1; i <= run.t.length; i += 1) {
    if (i === run.t.length || run.segments[i] !== run.segments[i - 1]) {
      out.push([first, i - 1]);
      first = i;
    }
  }
  return out;
}

function niceStep(metres) {
  const power = 10 ** Math.floor(Math.log10(metres));
  return [1, 2, 5, 10].map((k) => k * power).find((step) => step >= metres);
}
