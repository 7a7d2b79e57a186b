"use strict";

const MOST_LINES = 24; // of objects in one plot
const STAGE_COLORS = ["#56b4e9", "#e69f00", "#009e73", "#cc79a7", "#f0e442", "#0072b2", "#d55e00", "#999999"];
const AXES = ["x", "y", "z"];

/** All plots of the page; they are made anew when the theme changes. */
class Plots {
  constructor(host) {
    this.host = host;
    this.plots = [];
    this.observer = new ResizeObserver((entries) => {
      for (const entry of entries) this.fit(entry.target);
    });
  }

  build() {
    for (const { plot } of this.plots) plot.destroy();
    this.observer.disconnect();
    this.plots = [];
    this.host.replaceChildren();
    speedPlot(this);
    RUNS.forEach((run, i) => objectPlot(this, run, i));
    if (RUNS.some((run) => run.truth)) errorPlots(this);
    else sigmaPlots(this);
    neesPlot(this);
    RUNS.forEach((run, i) => timingPlot(this, run, i));
    this.show(clock.now);
  }

  /** A panel with a plot; lines are {label, x, y, color, ...} and may have different times. */
  add(title, unit, lines, options = {}) {
    const panel = make("div", { class: "panel" }, make("h3", {}, `${title} [${unit}]`));
    this.host.append(panel);
    if (!lines.length) {
      panel.append(make("p", { class: "quiet" }, options.empty || "Nothing to show."));
      return;
    }
    const data = lines.length === 1 || lines.every((line) => line.x === lines[0].x)
      ? [lines[0].x, ...lines.map((line) => line.y)]
      : uPlot.join(lines.map((line) => [line.x, line.y]));
    const axis = {
      stroke: css("--soft"), font: "12px system-ui, sans-serif",
      grid: { stroke: css("--grid"), width: 1 }, ticks: { stroke: css("--grid"), width: 1 },
    };
    const plot = new uPlot({
      width: Math.max(panel.clientWidth, 200),
      height: 190,
      scales: { x: { time: false }, y: { distr: options.log ? 3 : 1, ...(options.range && { range: options.range }) } },
      axes: [{ ...axis, values: (_, all) => all.map((t) => `${t} s`) }, { ...axis, size: 52 }],
      series: [{ label: "time", value: (_, t) => (t === null ? "–" : `${t.toFixed(2)} s`) }, ...lines.map(seriesOf)],
      bands: options.bands || [],
      legend: { live: true, show: options.legend !== false },
      cursor: { drag: { x: true, y: false }, points: { size: 6 } },
      hooks: { drawClear: options.shade ? [(u) => drawSpans(u, options.shade)] : [] },
    }, data, panel);
    const now = make("div", { class: "now" });
    plot.over.append(now);
    const entry = { plot, now, panel };
    this.plots.push(entry);
    this.observer.observe(panel);
    let pressed = 0;
    plot.over.addEventListener("pointerdown", (event) => { pressed = event.clientX; });
    plot.over.addEventListener("click", (event) => {
      if (Math.abs(event.clientX - pressed) > 3) return; // a drag zooms
      const left = event.clientX - plot.over.getBoundingClientRect().left;
      clock.setTime(plot.posToVal(left, "x"));
    });
    plot.over.addEventListener("mouseleave", () => this.showIn(entry, clock.now));
    plot.over.addEventListener("dblclick", () => this.showIn(entry, clock.now));
  }

  fit(panel) {
    const entry = this.plots.find((one) => one.panel === panel);
    const width = panel.clientWidth;
    if (!entry || !width || entry.plot.width === width) return;
    entry.plot.setSize({ width, height: 190 });
    this.showIn(entry, clock.now);
  }

  show(t) {
    for (const entry of this.plots) this.showIn(entry, t);
  }

  /** The line of the clock, and the legend's values at it. */
  showIn({ plot, now }, t) {
    const left = plot.valToPos(t, "x");
    const inside = left >= 0 && left <= plot.over.clientWidth;
    now.style.display = inside ? "block" : "none";
    now.style.left = `${left - 1}px`;
    now.dataset.time = t;
    plot.setLegend({ idx: lastUpTo(plot.data[0], t) }, false);
  }
}

function seriesOf(line) {
  return {
    label: line.label, stroke: line.color, width: line.width ?? 1.5, dash: line.dash, fill: line.fill,
    points: { show: line.points ?? false }, spanGaps: line.spanGaps ?? SEVERAL,
    value: line.value || ((_, value) => (value === null || value === undefined ? "–" : value.toFixed(line.digits ?? 2))),
  };
}

/** Intervals shaded behind a plot: health, standing. */
function drawSpans(u, shade) {
  const pen = u.ctx;
  for (const [intervals, color] of shade) {
    pen.fillStyle = color;
    for (const [a, b] of intervals) {
      const left = Math.max(u.valToPos(a, "x", true), u.bbox.left);
      const right = Math.min(u.valToPos(b, "x", true), u.bbox.left + u.bbox.width);
      if (right >= left) pen.fillRect(left, u.bbox.top, Math.max(right - left, 1), u.bbox.height);
    }
  }
}

function shadeOf(run) {
  return [
    [run.standing, css("--shade")],
    [run.health.degraded, "rgba(240, 197, 66, .25)"],
    [run.health.lost, "rgba(213, 94, 0, .3)"],
  ];
}

function nameOf(run, text) {
  return SEVERAL ? `${run.name}: ${text}` : text;
}

function speedPlot(plots) {
  const lines = RUNS.map((run, i) => ({
    label: SEVERAL ? run.name : "ego", x: run.t, y: run.ego.speed, color: runColor(i), width: 2,
  }));
  plots.add("Speed of the rig", "m/s", lines, { shade: SEVERAL ? null : shadeOf(RUNS[0]) });
}

function objectPlot(plots, run, i) {
  const longest = [...run.tracks].sort((a, b) => b.at.length - a.at.length).slice(0, MOST_LINES);
  const lines = longest.sort((a, b) => a.id - b.id).map((track) => {
    const y = new Array(run.t.length).fill(null);
    track.at.forEach((at, k) => { y[at] = track.speed[k]; });
    return { label: `#${track.id}`, x: run.t, y, color: trackColor(track.id), spanGaps: false };
  });
  const more = run.tracks.length > MOST_LINES ? `, the ${MOST_LINES} seen longest` : "";
  plots.add(nameOf(run, `Speeds of objects${more}`), "m/s", lines, { empty: "No moving object was confirmed." });
}

function errorPlots(plots) {
  const known = RUNS.map((run, i) => [run, i]).filter(([run]) => run.truth);
  for (const [part, unit, first] of [["Position error", "m", 3], ["Orientation error", "deg", 0]]) {
    AXES.forEach((axis, k) => {
      const lines = [];
      const bands = [];
      for (const [run, i] of known) {
        const bound = run.truth.bounds[first + k];
        const base = { x: run.t, color: runColor(i), digits: 3 };
        const below = bound.map((b) => (b === null ? null : -b));
        const band = { ...base, color: css("--warn"), width: 1, dash: SEVERAL ? [4, 4] : undefined };
        if (SEVERAL) band.color = base.color;
        bands.push({ series: [lines.length + 1, lines.length + 2], fill: SEVERAL ? "rgba(128, 128, 128, .06)" : "rgba(230, 159, 0, .14)" });
        lines.push({ ...band, y: bound, label: nameOf(run, "+3σ") });
        lines.push({ ...band, y: below, label: nameOf(run, "−3σ") });
        lines.push({ ...base, y: run.truth.errors[first + k], width: 2, label: nameOf(run, "error") });
      }
      plots.add(`${part}, ${axis}`, unit, lines, { bands, shade: SEVERAL ? null : shadeOf(RUNS[0]) });
    });
  }
}

/** Squared errors over their covariance, with the band that 95 % of honest ones keep. */
function neesPlot(plots) {
  const known = RUNS.map((run, i) => [run, i]).filter(([run]) => run.truth && run.truth.nees.some((part) => part.some((value) => value !== null)));
  if (!known.length) return;
  const [[first]] = known;
  const [low, high] = first.truth.nees_band;
  const edge = (value, label) => ({ label, x: first.t, y: first.t.map(() => value), color: css("--good"), width: 1, dash: [4, 4] });
  const lines = [edge(high, "95 % band"), edge(low, "95 % band")];
  for (const [run, i] of known) {
    ["orientation", "position"].forEach((part, k) => lines.push({
      label: nameOf(run, part), x: run.t, y: run.truth.nees[k].map((value) => value || null),
      color: SEVERAL ? runColor(i) : STAGE_COLORS[k], dash: SEVERAL && k === 0 ? [2, 3] : undefined,
    }));
  }
  plots.add("NEES, 3 where errors and covariance agree", "–", lines, {
    log: true, range: (_, __, top) => [low / 3, Math.max(3 * high, top)],
    bands: [{ series: [1, 2], fill: "rgba(0, 158, 115, .12)" }],
    shade: SEVERAL ? null : shadeOf(RUNS[0]),
  });
}

function sigmaPlots(plots) {
  for (const [part, unit, first] of [["1σ of position", "m", 3], ["1σ of orientation", "deg", 0]]) {
    const lines = RUNS.flatMap((run, i) => AXES.map((axis, k) => ({
      label: nameOf(run, axis), x: run.t, y: run.sigma[first + k], digits: 3,
      color: SEVERAL ? runColor(i) : STAGE_COLORS[k], dash: SEVERAL ? [[], [6, 3], [2, 3]][k] : undefined,
    })));
    plots.add(part, unit, lines, { shade: SEVERAL ? null : shadeOf(RUNS[0]) });
  }
}

/** Stages on top of each other; the slowest frames (a start, code that is compiled) are cut off. */
function timingPlot(plots, run, i) {
  if (!run.timing) return;
  const sums = [];
  const n = run.t.length;
  let before = new Array(n).fill(0);
  for (const values of run.timing.ms) {
    before = before.map((sum, k) => sum + (values[k] ?? 0));
    sums.push(before);
  }
  const usual = [...before].sort((a, b) => a - b)[Math.floor(0.9 * (n - 1))];
  const lines = run.timing.stages.map((stage, s) => ({
    label: stage, x: run.t, y: sums[s], color: STAGE_COLORS[s % STAGE_COLORS.length], width: 1,
    fill: s === 0 ? `${STAGE_COLORS[0]}66` : undefined,
    value: (_, __, ___, at) => (at === null || at === undefined ? "–" : `${shown(run.timing.ms[s][at], 1)} ms`),
  }));
  const bands = lines.slice(1).map((line, s) => ({ series: [s + 2, s + 1], fill: `${line.color}66` }));
  plots.add(nameOf(run, "Time of each stage"), "ms", lines, {
    bands, range: (_, low, high) => [0, Math.max(1.6 * usual, 1) || high],
  });
}
