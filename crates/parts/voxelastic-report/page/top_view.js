// The top view: vertical surfaces drawn dark, with trajectory, submaps, loops and the planned path over them.

/** Most pixels of the drawing along a side. */
const SHEET = 1600;

function drawTopView(chunks, bounds) {
  const pad = 0.02 * Math.max(bounds.high[0] - bounds.low[0], bounds.high[1] - bounds.low[1]) + 0.5;
  const low = [bounds.low[0] - pad, bounds.low[1] - pad], size = [0, 1].map((k) => bounds.high[k] + pad - low[k]);
  // A tall map lies down, so that it can be seen whole.
  const turnedMap = size[1] > size[0] * 1.25;
  const [wide, tall] = turnedMap ? [size[1], size[0]] : size;
  const place = turnedMap ? ([x, y]) => [y - low[1], x - low[0]] : ([x, y]) => [x - low[0], low[1] + size[1] - y];
  const scale = Math.min(SHEET / Math.max(wide, tall), 40);
  const width = Math.max(Math.round(wide * scale), 1), height = Math.max(Math.round(tall * scale), 1);
  const ink = uprightInk(chunks, place, scale, width, height);
  const canvas = byId("top-view-walls");
  Object.assign(canvas, { width, height });
  const paint = () => paintInk(canvas, ink, width, height);
  onTheme.push(paint);
  paint();
  overlay(place, wide, tall, turnedMap);
}

/** How much upright surface there is in each pixel. */
function uprightInk(chunks, place, scale, width, height) {
  const ink = new Float32Array(width * height);
  DATA.surfaces.forEach((s, i) => chunks[i].forEach(({ vertices }) => {
    const words = new Uint16Array(vertices.buffer);
    for (let v = 0; v < vertices.length; v += STRIDE) {
      const normal = turned(s.pose.slice(3), normalOf(vertices[v + 6], vertices[v + 7]));
      const p = place(moved(s.pose, [0, 1, 2].map((k) => s.origin[k] + s.step * words[v / 2 + k])));
      const x = Math.floor(p[0] * scale), y = Math.floor(p[1] * scale);
      if (x >= 0 && y >= 0 && x < width && y < height) ink[y * width + x] += Math.abs(normal[2]) < 0.5 ? 1 : 0.06;
    }
  }));
  return ink;
}

function paintInk(canvas, ink, width, height) {
  const colour = rgb(themed("--ink")).map((c) => c * 255);
  const sorted = Float32Array.from(ink.filter((v) => v > 0.5)).sort();
  const full = Math.max(sorted[Math.floor(sorted.length * 0.85)] || 1, 1);
  const picture = new ImageData(width, height);
  for (let i = 0; i < ink.length; i++) {
    picture.data.set(colour, i * 4);
    picture.data[i * 4 + 3] = 235 * Math.min(Math.sqrt(ink[i] / full), 1);
  }
  canvas.getContext("2d").putImageData(picture, 0, 0);
}

function overlay(place, wide, tall, turnedMap) {
  const lines = byId("top-view-lines");
  const { position, submap, node } = DATA.nodes;
  lines.setAttribute("viewBox", `0 0 ${wide} ${tall}`);
  const thin = Math.max(wide, tall) / 520;
  const text = (points) => points.map((p) => place(p).map((c) => c.toFixed(2)).join(" ")).join("L");
  const colours = new Map(DATA.surfaces.map((s) => [s.submap, hex(s.colour)]));
  const parts = [];
  const stroke = (d, attributes) => parts.push(svg("path", { d, fill: "none", "stroke-linecap": "round", "stroke-linejoin": "round", ...attributes }));
  const at = new Map(node.map((n, i) => [n, position[i]]));
  const came = DATA.run ? DATA.run.scans.position : [];
  const isMoved = came.some((p, i) => at.has(DATA.run.scans.node[i]) && Math.hypot(...sub(p, at.get(DATA.run.scans.node[i]))) > 0.02);
  if (isMoved && came.length > 1)
    stroke(`M${text(came)}`, { stroke: "var(--soft)", "stroke-width": thin, "stroke-dasharray": `${thin * 2} ${thin * 2.5}` });
  // One line per stretch within a submap.
  for (let i = 0, start = 0; i < position.length; i++)
    if (i + 1 === position.length || submap[i + 1] !== submap[i]) {
      stroke(`M${text(position.slice(start, i + 2))}`, { stroke: colours.get(submap[i]) || "var(--warm)", "stroke-width": thin * 2.4 });
      start = i + 1;
    }
  const loops = (DATA.run ? DATA.run.loops : []).filter((l) => at.has(l.from) && at.has(l.to));
  for (const l of loops) {
    stroke(`M${text([at.get(l.from), at.get(l.to)])}`, { stroke: "var(--rose)", "stroke-width": thin * 1.6 });
    for (const end of [l.from, l.to]) {
      const [x, y] = place(at.get(end));
      parts.push(svg("circle", { cx: x, cy: y, r: thin * 1.8, fill: "var(--rose)" }));
    }
  }
  if (DATA.planned_path) {
    for (const edge of DATA.planned_path.tree) stroke(`M${text(edge)}`, { stroke: "#d23b3b", "stroke-width": thin * 0.6 });
    if (DATA.planned_path.path.length > 1) stroke(`M${text(DATA.planned_path.path)}`, { stroke: "#2f6fe0", "stroke-width": thin * 3 });
    for (const [point, colour] of [[DATA.planned_path.start, "#2aa745"], [DATA.planned_path.goal, "#d8262c"]])
      if (point) parts.push(svg("circle", { cx: place(point)[0], cy: place(point)[1], r: thin * 5, fill: colour, stroke: "#fff", "stroke-width": thin }));
  }
  const dot = svg("circle", { r: thin * 5, fill: "none", stroke: "var(--ink)", "stroke-width": thin * 1.5, visibility: "hidden" });
  lines.replaceChildren(...parts, scaleBar(wide, tall, thin), dot);
  pointed.listeners.push((scan) => {
    const point = scan === null || !DATA.run ? null : at.get(DATA.run.scans.node[scan]);
    dot.setAttribute("visibility", point ? "visible" : "hidden");
    if (point) { const [x, y] = place(point); dot.setAttribute("cx", x); dot.setAttribute("cy", y); }
  });
  const key = [...(colours.size > 1 ? [["Trajectory, a colour per submap", [...colours.values()][0]]] : [["Trajectory", "var(--warm)"]]),
    ...(isMoved ? [["Poses as they came", "var(--soft)"]] : []), ...(loops.length ? [["Loop closures", "var(--rose)"]] : []),
    ...(DATA.planned_path ? [["Planned path", "#2f6fe0"], ["Search tree", "#d23b3b"]] : [])];
  byId("top-view-legend").replaceChildren(...key.map(([name, c]) => el("span", { style: `--c:${c}` }, name)));
  byId("top-view-lead").textContent = `Vertical surfaces are dark. ${turnedMap ? "Map x points down, y to the right" : "Map y points up"}; ` +
    `${loops.length ? `${loops.length} loop closures; ` : ""}point at a chart to find its scan here.`;
}

function scaleBar(wide, tall, thin) {
  const long = [5, 2, 1].map((m) => m * 10 ** Math.floor(Math.log10(wide / 5))).find((m) => m <= wide / 5), x = wide - long - thin * 8, y = tall - thin * 8;
  return svg("g", {}, svg("path", { d: `M${x} ${y - thin * 3}v${thin * 3}h${long}v${-thin * 3}`, stroke: "var(--ink)", "stroke-width": thin, fill: "none" }),
    svg("text", { x: x + long / 2, y: y - thin * 5, "text-anchor": "middle", style: `font-size:${thin * 8}px` }, `${short(long)} m`));
}
