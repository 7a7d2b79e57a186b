"use strict";

const STEP_MS = 33;
const map = new MapView(document.getElementById("map"));
const plots = new Plots(document.querySelector("#plots .panels"));

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  document.getElementById("theme").textContent = name === "dark" ? "Light" : "Dark";
  document.getElementById("overview").replaceChildren();
  overview(document.getElementById("overview"));
  strips();
  plots.build();
  map.draw();
}

function title() {
  const names = RUNS.map((run) => run.name).join(" · ");
  document.getElementById("title").textContent = names;
  const counts = {
    player: "Player", plots: "Plots", objects: `Objects (${sum((run) => run.objects.length)})`,
    warnings: `Warnings (${sum((run) => run.warnings.length + (run.remedy ? 1 : 0))})`,
    settings: "Settings", details: "Details",
  };
  const links = Object.entries(counts).map(([id, text]) => make("a", { href: `#${id}` }, text));
  document.getElementById("contents").append(...links);
  const truth = RUNS.find((run) => run.truth);
  const path = truth ? "Wide grey line: the true path. " : "";
  const bodies = truth && truth.truth.objects.length ? "Thin grey boxes: the true objects. " : "";
  document.getElementById("map-key").textContent = `${path}${bodies}Boxes: objects as seen now. Drag to move, wheel or two fingers to zoom.`;
}

function sum(count) {
  return RUNS.reduce((total, run) => total + count(run), 0);
}

/** A picture for each run: the overlay's last frame up to the clock's time. */
function viewers() {
  const host = document.getElementById("views");
  document.getElementById("player").classList.toggle("several", SEVERAL);
  RUNS.forEach((run, i) => {
    const caption = make("figcaption");
    if (!run.pictures.t.length) {
      caption.textContent = nameOf(run, "no pictures");
      host.append(make("figure", {}, make("div", { class: "empty" }, "This run kept no pictures."), caption));
      return;
    }
    const image = make("img", { alt: nameOf(run, "overlay: left image with objects, points, speeds") });
    const whole = () => figure.classList.toggle("whole");
    const button = make("button", { type: "button", class: "picture", title: "Full size", onclick: whole }, image);
    const figure = make("figure", {}, button, caption);
    host.append(figure);
    let shownIndex = -1;
    const show = (t) => {
      const index = lastUpTo(run.pictures.t, t);
      if (index === shownIndex) return;
      shownIndex = index;
      image.src = run.pictures.src[index];
      image.dataset.index = index;
      caption.textContent = nameOf(run, `left camera at ${run.pictures.t[index].toFixed(2)} s`);
    };
    clock.onChange(show);
    show(clock.now);
  });
}

/** Health below the slider, a strip for each run. */
function strips() {
  const host = document.getElementById("strips");
  const [start, end] = [clock.times[0], clock.times[clock.times.length - 1]];
  const span = Math.max(end - start, 1e-6);
  const at = (t) => (1000 * (t - start)) / span;
  host.replaceChildren(...RUNS.map((run) => {
    const strip = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    strip.setAttribute("viewBox", "0 0 1000 6");
    strip.setAttribute("preserveAspectRatio", "none");
    const add = (a, b, color) => {
      const box = document.createElementNS("http://www.w3.org/2000/svg", "rect");
      const size = { x: at(a), y: 0, width: Math.max(at(b) - at(a), 1), height: 6, fill: color };
      for (const [name, value] of Object.entries(size)) box.setAttribute(name, value);
      strip.append(box);
    };
    add(run.t[0], run.t[run.t.length - 1], css("--good"));
    for (const [a, b] of run.health.degraded) add(a, b, css("--warn"));
    for (const [a, b] of run.health.lost) add(a, b, css("--bad"));
    return strip;
  }));
}

function player() {
  const slider = document.getElementById("time");
  const play = document.getElementById("play");
  slider.max = clock.times.length - 1;
  let timer = null;
  let began = 0;
  let from = 0;

  function stop() {
    clearInterval(timer);
    timer = null;
    play.textContent = "▶";
    play.setAttribute("aria-label", "Play");
  }

  function start() {
    if (clock.index === clock.times.length - 1) clock.set(0);
    began = performance.now();
    from = clock.now;
    play.textContent = "❚❚";
    play.setAttribute("aria-label", "Pause");
    timer = setInterval(() => {
      clock.setTime(from + (performance.now() - began) / 1000);
      if (clock.index === clock.times.length - 1) stop();
    }, STEP_MS);
  }

  const toggle = () => (timer === null ? start() : stop());
  play.addEventListener("click", toggle);
  slider.addEventListener("input", () => { stop(); clock.set(Number(slider.value)); });
  document.addEventListener("keydown", (event) => {
    const typing = event.target.closest("input, button, summary, a, canvas");
    const moves = { ArrowLeft: -1, ArrowRight: 1, PageUp: 10, PageDown: -10 };
    if (event.key === " " && !typing) {
      event.preventDefault();
      toggle();
    } else if (moves[event.key] && !typing) {
      event.preventDefault();
      stop();
      clock.set(clock.index + moves[event.key]);
    }
  });
  clock.onChange((t) => {
    slider.value = clock.index;
    slider.setAttribute("aria-valuetext", `${t.toFixed(2)} s`);
    document.getElementById("now").textContent = `${t.toFixed(2)} s`;
  });
}

title();
viewers();
player();
objectTable(document.querySelector("#objects .scroll"));
warningList(document.getElementById("warnings"));
settingsTable(document.querySelector("#settings .scroll"));
detailTables(document.getElementById("details"));
clock.onChange((t) => { plots.show(t); map.draw(); });
setTheme(theme());
DARK.addEventListener("change", () => setTheme(DARK.matches ? "dark" : "light"));
document.getElementById("theme").addEventListener("click", () => setTheme(theme() === "dark" ? "light" : "dark"));
clock.set(0);
