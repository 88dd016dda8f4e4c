// What the pointer does: selects and moves submaps, names two for a closure, draws what is erased.

/** A pointer that moved less has clicked, pixels. */
const CLICK = { mouse: 5, pen: 8, touch: 14 };
const TOOLS = [
  { name: "move", text: "Select and move", key: "m", title: "Click a submap, drag its handles (M)" },
  { name: "closure", text: "Closure", key: "c", title: "Click two submaps that saw the same place: they are registered (C)" },
  { name: "box", text: "Box", key: "x", title: "Erase what is in a box, from above (X)" },
  { name: "measure", text: "Measure", key: "d", title: "Click points: distance, angle, area, height above the ground; Enter takes what is in the middle of the picture (D)" },
  { name: "lasso", text: "Lasso", key: "l", title: "Erase what is in an outline, from above (L)" },
];

/** The pointer on the picture; `acts` are `chosen`, `select`, `pair`, `mayMove`, `moved`, `outlined` and `measured`. */
class Tools {
  constructor(view, acts) {
    Object.assign(this, { view, acts, tool: "move", drag: null });
    const stage = byId("stage"), on = (kind, act) => stage.addEventListener(kind, (e) => e.target === view.canvas && act(e), { capture: true });
    on("pointerdown", (e) => this.down(e));
    on("pointermove", (e) => this.move(e));
    for (const kind of ["pointerup", "pointercancel"]) on(kind, (e) => this.up(e));
  }

  choose(tool) {
    Object.assign(this, { tool, drag: null });
    document.querySelectorAll("[data-tool]").forEach((b) => b.setAttribute("aria-pressed", String(b.dataset.tool === tool)));
    if (this.isErasing()) this.view.top();
    this.acts.chosen();
  }

  isErasing() { return this.tool === "box" || this.tool === "lasso"; }

  place(e) {
    const box = this.view.canvas.getBoundingClientRect();
    return [e.clientX - box.left, e.clientY - box.top];
  }

  down(e) {
    const from = this.place(e), { view } = this;
    if (e.button !== 0 || e.shiftKey && this.isErasing()) return;
    if (this.isErasing()) {
      this.drag = { outline: [from] };
      return this.own(e);
    }
    const handle = this.tool === "move" && view.gizmo?.at(from, e.pointerType);
    if (handle && this.acts.mayMove()) {
      this.drag = { poseAt: view.gizmo.taken(handle, from) };
      return this.own(e);
    }
    this.drag = { from };
  }

  /** The camera does not follow this pointer. */
  own(e) {
    e.stopPropagation();
    e.preventDefault();
    this.view.steered = true;
    this.view.canvas.focus({ preventScroll: true });
    try { this.view.canvas.setPointerCapture(e.pointerId); } catch { /* A pointer that a test made up. */ }
  }

  move(e) {
    const { drag } = this, to = this.place(e);
    if (!drag) return;
    if (drag.poseAt) this.acts.moved(drag.poseAt(to));
    else if (drag.outline) {
      if (this.tool === "lasso") drag.outline.push(to);
      else {
        const [a] = drag.outline;
        drag.outline = [a, [to[0], a[1]], to, [a[0], to[1]]];
      }
      this.drawOutline(drag.outline);
    } else return;
    e.stopPropagation();
  }

  up(e) {
    const { drag, view } = this, to = this.place(e);
    this.drag = null;
    if (!drag) return;
    if (drag.outline) {
      this.drawOutline([]);
      const polygon = this.onMap(drag.outline);
      if (polygon.length >= 3) this.acts.outlined(polygon);
    } else if (drag.from && e.type === "pointerup" && Math.hypot(to[0] - drag.from[0], to[1] - drag.from[1]) < (CLICK[e.pointerType] || CLICK.mouse)) {
      if (this.tool === "measure") return this.acts.measured(view.pick(...to));
      const submap = view.submapAt(...to);
      if (this.tool === "closure") this.acts.pair(submap);
      else this.acts.select(submap);
    }
  }

  drawOutline(points) {
    document.querySelector("#outline polygon").setAttribute("points", points.map((p) => p.map((c) => c.toFixed(1)).join(",")).join(" "));
  }

  /** An outline on the picture as one on the map, at the height of what is seen in it. */
  onMap(outline) {
    const { view } = this, middle = scaled(outline.reduce((a, b) => add(a, b)), 1 / outline.length);
    const inside = outline.flatMap((p) => [0.3, 0.6, 0.9].map((s) => add(scaled(middle, 1 - s), scaled(p, s))));
    const heights = [middle, ...inside].map((p) => view.pick(...p)).filter(Boolean).map((p) => p[2]);
    const height = heights.length ? quantile(heights, 0.5) : (view.bounds.low[2] + view.bounds.high[2]) / 2;
    const far = 0.004 * view.camera.distance, kept = [];
    for (const point of outline.map((p) => view.onPlane(...p, height)))
      if (point && (!kept.length || Math.hypot(point[0] - kept.at(-1)[0], point[1] - kept.at(-1)[1]) > far)) kept.push(point.slice(0, 2));
    return kept;
  }
}
