"use strict";

const RUNS = DATA.runs;
const SEVERAL = RUNS.length > 1;

// Okabe and Ito's colours; those that are too pale on white are darker in the light page.
const COLORS = {
  dark: {
    runs: ["#56b4e9", "#e69f00", "#cc79a7", "#009e73", "#f0e442", "#d55e00"],
    tracks: ["#e69f00", "#56b4e9", "#f0e442", "#cc79a7", "#00b888", "#ff7a2a"],
  },
  light: {
    runs: ["#0072b2", "#b87a00", "#a8507f", "#00795a", "#847a00", "#d55e00"],
    tracks: ["#c98500", "#2a8fce", "#9a8f00", "#b35a8c", "#00795a", "#d55e00"],
  },
};

function runColor(i) {
  const colors = COLORS[theme()].runs;
  return colors[i % colors.length];
}

function trackColor(id) {
  const colors = COLORS[theme()].tracks;
  return colors[id % colors.length];
}

/** The index of the last of rising numbers that is not above t; 0 where all are. */
function lastUpTo(numbers, t) {
  let low = 0;
  let high = numbers.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (numbers[middle] <= t + 1e-6) low = middle + 1;
    else high = middle;
  }
  return Math.max(low - 1, 0);
}

/** The one time that everything on the page shows. */
const clock = {
  times: [...new Set(RUNS.flatMap((run) => run.t))].sort((a, b) => a - b),
  index: 0,
  listeners: [],
  get now() {
    return this.times[this.index];
  },
  set(index) {
    this.index = Math.min(Math.max(Math.round(index), 0), this.times.length - 1);
    for (const listener of this.listeners) listener(this.now);
  },
  setTime(t) {
    this.set(lastUpTo(this.times, t));
  },
  onChange(listener) {
    this.listeners.push(listener);
  },
};
