"use strict";

/** The objects of all runs; rows of those seen now are marked. */
function objectTable(host) {
  const rows = RUNS.flatMap((run, i) => run.objects.map((object) => ({ ...object, run: run.name, color: runColor(i) })));
  if (!rows.length) {
    host.append(make("p", { class: "quiet" }, RUNS.some((run) => run.looked_for_objects) ? "No moving object was confirmed." : "Moving objects were not looked for."));
    return;
  }
  const jump = (row) => make(
    "button", { type: "button", title: "Go to where it is first seen", onclick: () => clock.setTime(row.first) },
    swatch(trackColor(row.id)), `#${row.id}`);
  const views = rows.some((row) => row.view);
  const size = (row) => row.size.map((metres) => shown(metres, 1)).join(" × ");
  const columns = [
    views && { title: "view", text: true, cell: (row) => row.view && make("img", { src: row.view, alt: `object ${row.id}` }) },
    { title: "object", text: true, of: (row) => row.id, cell: jump },
    SEVERAL && { title: "run", text: true, of: (row) => row.run },
    rows.some((row) => row.kind) && { title: "class", text: true, of: (row) => row.kind },
    { title: "first seen [s]", of: (row) => row.first, digits: 1 },
    { title: "for [s]", of: (row) => row.seconds, digits: 1 },
    { title: "frames", of: (row) => row.frames, digits: 0 },
    { title: "speed [m/s]", of: (row) => row.speed, digits: 1 },
    { title: "fastest [m/s]", of: (row) => row.fastest, digits: 1 },
    { title: "nearest [m]", of: (row) => row.nearest, digits: 1 },
    { title: "l × w × h [m]", of: (row) => row.size[0], cell: size },
    { title: "points", of: (row) => row.points, digits: 0 },
  ].filter(Boolean);
  const made = sortable(rows, columns, columns.find((column) => column.title === "first seen [s]"));
  host.append(made.table);
  clock.onChange((t) => rows.forEach((row, i) => {
    made.rows[i].classList.toggle("here", row.first <= t && t <= row.first + row.seconds);
  }));
}

function warningList(host) {
  const before = host.childElementCount;
  for (const run of RUNS) {
    if (run.remedy) {
      host.append(make("div", { class: "warning" }, make("p", {}, make("b", {}, nameOf(run, run.ended))), make("p", { class: "quiet" }, run.remedy)));
    }
    for (const warning of run.warnings) {
      const times = warning.count > 1 ? ` (${warning.count})` : "";
      host.append(make(
        "div", { class: "warning" },
        make("p", {}, make("b", {}, nameOf(run, warning.message + times))),
        make("p", { class: "quiet" }, warning.remedy)));
    }
  }
  if (host.childElementCount === before) host.append(make("p", { class: "quiet" }, "None."));
}

/** A row for each setting that some run changed. */
function settingsTable(host) {
  const keys = [...new Set(RUNS.flatMap((run) => run.settings.map((setting) => setting.key)))];
  if (!keys.length) {
    host.append(make("p", { class: "quiet" }, "None: all settings are the defaults."));
    return;
  }
  const rows = keys.map((key) => {
    const found = RUNS.map((run) => run.settings.find((setting) => setting.key === key));
    const any = found.find(Boolean);
    return { key, found, default: any.default, meaning: any.meaning };
  });
  const value = (setting, row) => (setting ? setting.value + (setting.from ? ` (${setting.from})` : "") : row.default);
  const columns = [
    { title: "setting", text: true, of: (row) => row.key },
    ...RUNS.map((run, i) => ({ title: SEVERAL ? run.name : "value", text: true, of: (row) => value(row.found[i], row) })),
    { title: "default", text: true, of: (row) => row.default },
    { title: "meaning", text: true, of: (row) => row.meaning },
  ];
  host.append(sortable(rows, columns).table);
}

function detailTables(host) {
  for (const run of RUNS) {
    const rows = run.details.map((row) => make(
      "tr", {}, make("td", {}, row.part), make("td", {}, row.name), make("td", { class: "long" }, row.value)));
    const table = make("table", {}, make("tbody", {}, ...rows));
    host.append(make("details", {}, make("summary", {}, nameOf(run, "input, options, counts and versions")), make("div", { class: "scroll" }, table)));
  }
}

/** The headline: cards for one run, a table to compare several. */
function overview(host) {
  if (!SEVERAL) {
    const facts = RUNS[0].facts.map((fact) => make("div", { class: "fact" }, make("b", {}, fact.value), make("span", {}, fact.name)));
    host.append(make("div", { class: "facts" }, ...facts));
    return;
  }
  const names = [...new Set(RUNS.flatMap((run) => run.facts.map((fact) => fact.name)))];
  const value = (run, name) => (run.facts.find((fact) => fact.name === name) || { value: "–" }).value;
  const head = make("tr", {}, make("th", { scope: "col" }, "run"), ...names.map((name) => make("th", { scope: "col" }, name)));
  const rows = RUNS.map((run, i) => make(
    "tr", {}, make("th", { scope: "row" }, swatch(runColor(i)), run.name),
    ...names.map((name) => make("td", {}, value(run, name)))));
  host.append(make("div", { class: "scroll" }, make("table", {}, make("thead", {}, head), make("tbody", {}, ...rows))));
}
