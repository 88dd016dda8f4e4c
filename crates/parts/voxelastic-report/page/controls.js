// The panel beside the 3D view.

/** What surfaces can be coloured by; the order is that of `mode` in the shader. */
const COLOURS = [
  { name: "Height", ramp: "height" },
  { name: "Submap", ramp: null },
  { name: "Intensity", ramp: "intensity", wants: "has_intensities" },
  { name: "Scale", ramp: "scale" },
  { name: "Error", ramp: "error", wants: "has_errors" },
  { name: "As seen", ramp: null, wants: "has_colours" },
];

const TITLES = { has_errors: "Distance from the truth: voxelastic report MAP --truth T (5)", has_colours: "The scans' own colours (6)" };

/** The panel beside the view. */
function panel(view) {
  const { show } = view;
  const redraw = () => { legend(view); view.draw(); };
  const has = (wants) => !wants || DATA.surfaces.some((s) => s[wants]);
  // What nobody misses is left out; errors are shown as something that could be had.
  const buttons = COLOURS.map(({ name, wants }, mode) => has(wants) || wants === "has_errors" ? el("button", {
    type: "button", "data-mode": mode, "aria-pressed": String(mode === show.mode),
    disabled: !has(wants), title: TITLES[wants] || `Colour by ${name.toLowerCase()} (${mode + 1})`,
    onclick: () => {
      show.mode = mode;
      buttons.forEach((b, i) => b?.setAttribute("aria-pressed", i === mode));
      redraw();
    },
  }, name) : null);
  byId("panel").append(
    el("fieldset", {}, el("legend", {}, "Colour"), el("div", { class: "choices" }, ...buttons.filter(Boolean))),
    sliceSliders(view),
    layers(view, redraw),
    ...(DATA.exploration ? [explorationSlider(view)] : []),
    ...(DATA.moving.length ? [movingSlider(view)] : []),
    ...(DATA.surfaces.some((s) => s.first_pose) ? [bendSlider(view)] : []),
  );
  byId("panel").addEventListener("submit", (e) => e.preventDefault());
  for (const button of document.querySelectorAll("[data-view]"))
    button.addEventListener("click", () => ({ reset: () => view.reset(), top: () => view.top(), full: fillScreen })[button.dataset.view]());
  legend(view);
}

/** Two heights between which the map is shown. */
function sliceSliders(view) {
  const [low, high] = view.bounds.all;
  const slider = (name, key, start) => {
    const output = el("output", {}, "all");
    const input = el("input", { type: "range", min: 0, max: 1000, value: start, id: `slice-${key}`, "aria-label": `Show what is ${name} a height` });
    input.addEventListener("input", () => {
      const off = Number(input.value) === start;
      const height = low + ((high - low) * input.value) / 1000;
      view.show[key] = off ? (key === "low" ? -Infinity : Infinity) : height;
      output.value = off ? "all" : `${height.toFixed(1)} m`;
      view.draw();
    });
    return el("label", {}, name, input, output);
  };
  return el("fieldset", {}, el("legend", {}, "Slice by height"), slider("below", "high", 1000), slider("above", "low", 0));
}

/** What can be shown and hidden. */
function layers(view, redraw) {
  const box = (key, text) => el("label", {}, el("input", {
    type: "checkbox", checked: view.show[key], id: `show-${key}`, onchange: (e) => { view.show[key] = e.target.checked; redraw(); },
  }), text);
  const loops = view.lines.loops.count, plan = view.lines.plan.count, moving = DATA.moving.reduce((sum, m) => sum + m.coordinates.length / 3, 0);
  return el("fieldset", {}, el("legend", {}, "Show"), box("path", "Trajectory"),
    ...(loops ? [box("loops", `Loop closures (${loops})`)] : []), ...(plan ? [box("plan", "Planned path")] : []),
    ...(DATA.exploration ? [box("exploration", "Exploration")] : []), ...(moving ? [box("moving", `Things that moved (${moving} points)`)] : []), box("backs", "Backs of surfaces: roofs, ceilings"));
}

/** A button that plays: it calls `set` with shares from 0 to 1 for so many milliseconds, unless `stop` is called. */
function player(id, title, length, set) {
  let playing = 0;
  const play = () => {
    const start = performance.now();
    const step = (time) => {
      if (playing !== step) return;
      const share = Math.min(Math.max(time - start, 0) / length, 1);
      set(share);
      if (share < 1) requestAnimationFrame(step);
    };
    playing = step;
    requestAnimationFrame(step);
  };
  return { button: el("button", { type: "button", id, title, onclick: play }, "▶"), stop: () => { playing = 0; } };
}

/** How much of the corrections is applied to the submaps. */
function bendSlider(view) {
  const output = el("output", {}, "100 %");
  const input = el("input", { type: "range", min: 0, max: 100, value: 100, id: "bend", "aria-label": "Share of the pose corrections that is applied" });
  const set = (percent) => {
    input.value = percent;
    output.value = `${Math.round(percent)} %`;
    view.bend(percent / 100);
    view.draw();
  };
  const { button, stop } = player("play-bend", "From the poses as they came to the corrected ones", 2150, (share) => {
    // It begins after a moment.
    const t = Math.max((2150 * share - 350) / 1800, 0);
    set(100 * t * t * (3 - 2 * t));
  });
  input.addEventListener("input", () => { stop(); set(Number(input.value)); });
  return el("fieldset", {}, el("legend", {}, "Corrections of the poses"), el("label", {}, button, input, output));
}

/** What the colours mean. */
function legend(view) {
  const box = byId("legend");
  const { ramp, name } = COLOURS[view.show.mode];
  const [low, high] = view.bounds.heights.map((h) => `${h.toFixed(1)} m`);
  if (!ramp) return void box.replaceChildren(el("b", {}, name === "Submap" ? `${DATA.surfaces.length} submaps` : "Colours of the scans"));
  if (ramp === "scale") {
    const stops = DATA.ramps.scale, finest = DATA.voxel_m || 0;
    const swatch = (s) => el("span", { style: `--c:${hex(stops[Math.round((1 - s / 3) * (stops.length - 1))])}` }, finest ? `${short(finest * 100 * 2 ** s)} cm` : `scale ${s}`);
    return void box.replaceChildren(el("b", {}, "Size of voxels"), el("div", { class: "swatches" }, ...[0, 1, 2, 3].map(swatch)));
  }
  const ends = { height: [low, high], intensity: ["dark", "bright"], error: ["0", `${short(DATA.error_max * 100)} cm and more`] }[ramp];
  const bar = el("canvas", { width: 256, height: 1 });
  const pixels = bar.getContext("2d"), stops = DATA.ramps[ramp];
  for (let i = 0; i < 256; i++) {
    pixels.fillStyle = hex(stops[Math.round((i / 255) * (stops.length - 1))]);
    pixels.fillRect(i, 0, 1, 1);
  }
  box.replaceChildren(el("b", {}, name === "Error" ? "Distance from the truth" : name), bar, el("div", {}, ...ends.map((e) => el("span", {}, e))));
}
