// Data, elements, numbers, colours.

const DATA = JSON.parse(document.getElementById("data").textContent);
const byId = (id) => document.getElementById(id);

/** An HTML element with attributes and children (elements or text). */
function el(name, attributes = {}, ...children) {
  return filled(document.createElement(name), attributes, children);
}

/** An SVG element. */
function svg(name, attributes = {}, ...children) {
  return filled(document.createElementNS("http://www.w3.org/2000/svg", name), attributes, children);
}

function filled(element, attributes, children) {
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (value !== null && value !== undefined && value !== false) element.setAttribute(key, value === true ? "" : value);
  }
  element.append(...children);
  return element;
}

/** A number with as many digits as are worth reading. */
function short(value) {
  const a = Math.abs(value);
  if (!Number.isFinite(value)) return "–";
  if (a >= 1000) return Math.round(value).toLocaleString("en");
  const digits = a >= 100 ? 0 : a >= 10 ? 1 : a >= 1 ? 2 : a === 0 ? 0 : 3;
  return String(Number(value.toFixed(digits)));
}

const most = (values) => values.reduce((a, b) => (b > a ? b : a), -Infinity);
const least = (values) => values.reduce((a, b) => (b < a ? b : a), Infinity);
const mean = (values) => values.reduce((a, b) => a + b, 0) / Math.max(values.length, 1);

/** The value below which a share of the values lies. */
function quantile(values, share) {
  const sorted = Float64Array.from(values).sort();
  return sorted[Math.min(sorted.length - 1, Math.max(0, Math.ceil(sorted.length * share) - 1))];
}

/** Round numbers from `low` to `high`, about `count` of them. */
function ticks(low, high, count) {
  const raw = (high - low) / Math.max(count, 1);
  if (!(raw > 0)) return [low];
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= raw * 0.999);
  const out = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + step * 1e-9; i++) out.push(Number((i * step).toPrecision(12)));
  return out;
}

/** A CSS variable of the theme as it is now. */
const themed = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** "#rrggbb" as three numbers from 0 to 1. */
function rgb(hex) {
  return [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255);
}
const hex = (c) => "#" + c.map((v) => v.toString(16).padStart(2, "0")).join("");

/** Calls `draw` in the frame after the element has got another width, the first one included. */
function onWidth(element, draw) {
  let width = -1;
  new ResizeObserver(() => {
    if (element.clientWidth === width) return;
    width = element.clientWidth;
    requestAnimationFrame(draw);
  }).observe(element);
}

// What depends on the theme draws itself anew when it changes.
const onTheme = [];
function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  onTheme.forEach((draw) => draw());
}
const preferred = matchMedia("(prefers-color-scheme: dark)");
document.documentElement.dataset.theme = preferred.matches ? "dark" : "light";
preferred.addEventListener("change", (e) => setTheme(e.matches ? "dark" : "light"));
byId("theme").addEventListener("click", () => setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark"));

// The scan that the reader points at, in any chart or in the top view; the others follow.
const pointed = {
  listeners: [],
  at(scan, from) { this.listeners.forEach((listen) => listen(scan, from)); },
};
