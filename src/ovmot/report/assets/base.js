"use strict";

const DATA = JSON.parse(document.getElementById("data").textContent);
const DARK = window.matchMedia("(prefers-color-scheme: dark)");
document.documentElement.dataset.theme = DARK.matches ? "dark" : "light";

function theme() {
  return document.documentElement.dataset.theme;
}

function css(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

/** An element with attributes and children; texts are always texts, never markup. */
function make(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (value !== null && value !== undefined) made.setAttribute(name, value);
  }
  made.append(...children.filter((child) => child !== null && child !== undefined));
  return made;
}

function swatch(color) {
  const made = make("span", { class: "swatch" });
  made.style.background = color;
  return made;
}

function shown(value, digits) {
  return value === null || value === undefined ? "–" : value.toFixed(digits);
}
