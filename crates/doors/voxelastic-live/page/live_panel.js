// The panel: figures, colours, what is shown; and the buttons of the corner.

function livePanel(view) {
  const { show } = view;
  const buttons = COLOURS.map((colour, mode) => colour && el("button", {
    type: "button", "data-mode": mode, "aria-pressed": String(mode === show.mode), title: `Colour by ${colour.name.toLowerCase()} (${mode + 1})`,
    onclick: () => {
      show.mode = mode;
      buttons.forEach((b, i) => b?.setAttribute("aria-pressed", i === mode));
      view.draw();
    },
  }, colour.name));
  const box = (key, text) => el("label", {}, el("input", {
    type: "checkbox", checked: show[key], id: `show-${key}`, onchange: (e) => { show[key] = e.target.checked; view.draw(); },
  }), text);
  byId("panel").append(
    el("fieldset", {}, el("legend", {}, "Colour"), el("div", { class: "choices" }, ...buttons.filter(Boolean))),
    el("fieldset", {}, el("legend", {}, "Show"), box("scan", "Last scan"), box("robot", "Robot"), box("path", "Trajectory"), box("loops", "Loop closures"),
      box("backs", "Backs of surfaces: roofs, ceilings")));
  byId("panel").addEventListener("submit", (e) => e.preventDefault());
  const follow = (on) => {
    view.follow = on;
    document.querySelector('[data-view="follow"]').setAttribute("aria-pressed", String(on));
    view.stale = on || view.stale;
    view.draw();
  };
  const acts = {
    follow: () => follow(!view.follow), full: fillScreen,
    reset: () => { follow(false); view.reset(); }, top: () => { follow(false); view.top(); },
  };
  document.querySelectorAll("[data-view]").forEach((b) => b.addEventListener("click", () => acts[b.dataset.view]()));
  view.canvas.addEventListener("keydown", (e) => { if (e.key === "g" || e.key === "G") follow(!view.follow); });
  view.canvas.addEventListener("pointerdown", () => setTimeout(() => { byId("hint").style.opacity = 0; }, 2500), { once: true });
  onTheme.push(() => { view.stale = true; view.draw(); });
  // Colours that the scans do not have are not offered.
  return () => buttons.forEach((b, i) => b && (b.hidden = Boolean(COLOURS[i].flag) && !(view.flags & COLOURS[i].flag)));
}

/** The figures of the node: names and values as it sends them, and those of the page. */
function showFigures(figures) {
  const rows = figures.rows || [];
  byId("figures").replaceChildren(...rows.flatMap(([name, value]) => [el("dt", {}, name), el("dd", {}, value)]));
}
