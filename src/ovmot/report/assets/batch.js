"use strict";

const SVG = "http://www.w3.org/2000/svg";

function figure(value) {
  if (value === null || value === undefined) return "–";
  return Number(value.toPrecision(4)).toString();
}

/** A run's name, with a link to its page where it has one. */
function named(run) {
  return run.report ? make("a", { href: run.report }, run.name) : make("span", {}, run.name);
}

function within(id) {
  return document.querySelector(`#${id} .scroll`);
}

function failures() {
  const host = document.getElementById("failures");
  const failed = Object.entries(DATA.failures);
  host.hidden = !failed.length;
  for (const [name, line] of failed) {
    host.append(make("div", { class: "warning" }, make("p", {}, make("b", {}, name)), make("p", {}, line)));
  }
}

function worst() {
  const columns = [
    { title: "metric", text: true, of: (row) => row.metric },
    { title: "sequence", text: true, of: (row) => row.run.sequence },
    { title: "settings", text: true, of: (row) => row.run.settings },
    { title: "worst run", text: true, of: (row) => row.run.name, cell: (row) => named(row.run) },
    { title: "value", of: (row) => row.value, cell: (row) => figure(row.value) },
    { title: "median", of: (row) => row.median, cell: (row) => figure(row.median) },
  ];
  const rows = DATA.worst.map((row) => ({ ...row, run: DATA.runs[row.run] }));
  if (rows.length) within("worst").append(sortable(rows, columns).table);
  else within("worst").append(make("p", { class: "quiet" }, "No run has finished."));
}

/** All values of a metric on one line, and their median. */
function strip(spread) {
  const svg = document.createElementNS(SVG, "svg");
  const add = (tag, attributes) => {
    const made = document.createElementNS(SVG, tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    svg.append(made);
  };
  for (const [name, value] of Object.entries({ viewBox: "0 0 160 16", width: 160, height: 16, role: "img" })) {
    svg.setAttribute(name, value);
  }
  const span = spread.greatest - spread.least;
  const at = (value) => (span > 0 ? 8 + (144 * (value - spread.least)) / span : 80);
  add("line", { x1: 8, x2: 152, y1: 8, y2: 8, stroke: css("--line"), "stroke-width": 2 });
  add("line", { x1: at(spread.median), x2: at(spread.median), y1: 1, y2: 15, stroke: css("--strong"), "stroke-width": 2 });
  for (const value of spread.values) {
    add("circle", { cx: at(value), cy: 8, r: 4, fill: css("--strong"), "fill-opacity": 0.5 });
  }
  return svg;
}

function spreads() {
  const digits = (name) => ({ title: name === "least" ? "min" : name === "greatest" ? "max" : name, of: (row) => row[name], cell: (row) => figure(row[name]) });
  const columns = [
    { title: "sequence", text: true, of: (row) => row.sequence },
    { title: "settings", text: true, of: (row) => row.settings },
    { title: "metric", text: true, of: (row) => row.metric },
    { title: "runs", of: (row) => row.count, digits: 0 },
    ...["mean", "median", "std", "least", "greatest"].map(digits),
    { title: "spread", text: true, cell: strip },
  ];
  const host = within("spreads");
  const draw = (rows) => host.replaceChildren(sortable(rows, columns).table, button);
  const usual = DATA.spreads.filter((row) => row.usual);
  const button = make("button", { type: "button", onclick: () => { draw(DATA.spreads); button.remove(); } }, `All ${DATA.spreads.length} rows`);
  draw(usual.length ? usual : DATA.spreads);
  if (usual.length === DATA.spreads.length || !usual.length) button.remove();
}

function consistency() {
  const none = !DATA.consistency.length;
  document.getElementById("consistency").hidden = none;
  document.querySelector("nav [href='#consistency']").hidden = none;
  const verdict = (row) => make("span", { class: row.mean > row.high ? "bad" : row.mean < row.low ? "warn" : "good" },
    row.mean > row.high ? "overconfident" : row.mean < row.low ? "too cautious" : "inside");
  const columns = [
    { title: "sequence", text: true, of: (row) => row.sequence },
    { title: "settings", text: true, of: (row) => row.settings },
    { title: "metric", text: true, of: (row) => row.metric },
    { title: "runs", of: (row) => row.runs, digits: 0 },
    { title: "mean NEES", of: (row) => row.mean, digits: 2 },
    { title: "band", text: true, of: (row) => `${figure(row.low)} … ${figure(row.high)}` },
    { title: "", text: true, cell: verdict },
  ];
  within("consistency").replaceChildren(sortable(DATA.consistency, columns).table);
}

function allRuns() {
  const metrics = DATA.metrics.filter((name) => DATA.runs.some((run) => run.metrics[name] !== undefined));
  const columns = [
    { title: "run", text: true, of: (row) => row.name, cell: named },
    ...metrics.map((name) => ({ title: name, of: (row) => row.metrics[name], cell: (row) => figure(row.metrics[name]) })),
  ];
  within("runs").append(sortable(DATA.runs, columns).table);
}

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  document.getElementById("theme").textContent = name === "dark" ? "Light" : "Dark";
  spreads();
}

document.getElementById("title").textContent = `${DATA.name}: ${DATA.runs.length} runs`;
failures();
worst();
consistency();
allRuns();
setTheme(theme());
DARK.addEventListener("change", () => setTheme(DARK.matches ? "dark" : "light"));
document.getElementById("theme").addEventListener("click", () => setTheme(theme() === "dark" ? "light" : "dark"));
