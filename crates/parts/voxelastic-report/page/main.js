// Puts the page together.

function facts() {
  byId("facts").append(...DATA.facts.map((f) => el("div", {}, el("dt", {}, f.label), el("dd", {}, f.value, el("small", {}, f.unit)), el("p", {}, f.note))));
}

/** A table whose first column names the rows. */
function table(columns, rows) {
  return el("div", { class: "scroller" }, el("table", {},
    el("thead", {}, el("tr", {}, ...columns.map((c) => el("th", { scope: "col" }, c)))),
    el("tbody", {}, ...rows.map((row) => el("tr", {}, ...row.map((cell, i) => el(i ? "td" : "th", i ? {} : { scope: "row" }, cell)))))));
}

function tables() {
  const section = byId("tables");
  section.append(...DATA.tables.map((t) => el("div", { class: "tables" }, el("h2", {}, t.title), el("p", { class: "lead" }, t.note), table(t.columns, t.rows))));
  if (DATA.distances.length) {
    const colours = ["--accent", "--warm", "--violet", "--gold"];
    section.append(el("div", { class: "tables" }, el("h2", {}, "Distances from the truth"),
      el("p", { class: "lead" }, "Share of the map by distance; the line is the share within it."),
      el("div", { class: "grid" }, ...DATA.distances.map((d, i) => errorChart(d, colours[i % colours.length])))));
  }
  section.hidden = !section.childElementCount;
}

function explored() {
  if (!DATA.exploration || !DATA.exploration.moments.length) return;
  byId("charts").hidden = false;
  byId("run-charts").append(...knownCharts(DATA.exploration));
}

function run() {
  if (!DATA.run || !DATA.run.scans.node.length) return;
  byId("charts").hidden = false;
  const { threads, total_s: total, scans, interrupted } = DATA.run;
  byId("run-lead").textContent = `${scans.node.length} scans in ${short(total)} s with ${threads} thread${threads === 1 ? "" : "s"}, reading included` +
    `${interrupted ? "; ended early" : ""}. Across: the number of the scan.`;
  byId("run-charts").append(...runCharts(DATA.run));
  byId("charts").append(...triedClosures(DATA.run), ...closures(DATA.run));
}

/** Verdicts on loop closures, as people say them. */
const VERDICTS = {
  accepted: "accepted",
  free_space: "surfaces in space that was observed to be free",
  poor_fit: "surfaces do not lie on each other",
  not_registered: "could not be registered",
  beyond_drift: "the odometry cannot be as wrong as that",
};

/** Places that looked alike: which closures were accepted, and why the others were refused. */
function triedClosures({ closures: tried }) {
  if (!tried.length) return [];
  const count = (verdict) => tried.filter((c) => c.verdict === verdict).length;
  const refused = Object.entries(VERDICTS).filter(([key]) => key !== "accepted" && count(key)).map(([key, words]) => `${count(key)}: ${words}`);
  const share = (v) => (v === null || v === undefined ? "–" : `${short(100 * v)} %`);
  const rows = tried.map((c) => [`${c.from} – ${c.to}`, VERDICTS[c.verdict] || c.verdict, share(c.contradiction), share(c.overlap),
    c.score === null || c.score === undefined ? "–" : short(c.score), short(c.correlation), `${short(c.correction_m)} m`]);
  const summary = `Places that look alike: ${count("accepted")} closures accepted; refused ${refused.length ? refused.join(", ") : "none"}`;
  return [el("details", { id: "tried" }, el("summary", {}, summary),
    table(["scans", "verdict", "in free space", "overlap", "score", "likeness", "correction"], rows))];
}

/** Loop closures and corrections, each with its time. */
function closures({ loops, corrections }) {
  const ms = (time) => (time === null || time === undefined ? "–" : `${short(time)} ms`);
  const events = [
    ...loops.map((l) => ({ ...l, cells: [`loop ${l.from} – ${l.to}`, ms(l.wall_ms), "–", "–", "–", l.fusions] })),
    ...corrections.map((c) => ({ ...c, cells: ["poses corrected", ms(c.wall_ms), ms(c.optimise_ms), c.moved, c.closed, c.fusions] })),
  ].filter((e) => e.wall_ms > 0).sort((a, b) => a.after - b.after);
  if (!events.length) return [];
  const slowest = most(events.map((e) => e.wall_ms));
  const rows = events.map((e) => [String(e.after), ...e.cells.map(String)]);
  return [el("details", { id: "closures" }, el("summary", {}, `Loop closures: at most ${short(slowest)} ms each`),
    table(["scans before", "what", "mapper", "optimiser", "submaps moved", "loops closed", "fusions asked"], rows))];
}

function details() {
  byId("details").hidden = !DATA.details.length;
  byId("detail-list").append(...DATA.details.map(([name, value]) => el("div", {}, el("dt", {}, name), el("dd", {}, value))));
}

async function scene() {
  if (!DATA.surfaces.some((s) => s.chunks.length)) return;
  byId("scene").hidden = false;
  try {
    const chunks = unpacked(await blobBytes());
    byId("top-view").hidden = false;
    drawTopView(chunks, boundsOf(chunks));
    const view = new View(byId("canvas"), chunks);
    steer(view);
    panel(view);
    onTheme.push(() => { view.bend(view.show.bend); view.draw(); });
    pointed.listeners.push((scan) => mark(view, scan));
    hint();
    byId("stage").dataset.ready = "yes";
  } catch (error) {
    for (const id of ["panel", "legend", "hint"]) byId(id).hidden = true;
    byId("stage").append(el("p", { class: "message" }, `The map cannot be shown in 3D: ${error.message}. A current Firefox, Chrome or Safari can.`));
    byId("stage").dataset.ready = "no";
  }
}

/** Where the scan is that the reader points at in a chart. */
function mark(view, scan) {
  const index = scan === null || !DATA.run ? -1 : DATA.nodes.node.indexOf(DATA.run.scans.node[scan]);
  const at = index < 0 ? null : view.project(view.path[index]);
  byId("labels").replaceChildren(...(at ? [el("span", { style: `left:${at[0]}px;top:${at[1]}px` }, `scan ${scan}`)] : []));
}

/** How to move, until the reader has moved. */
function hint() {
  const box = byId("hint");
  box.textContent = "drag to turn · shift-drag to move · click, then wheel to zoom · double-click to go there";
  byId("canvas").addEventListener("pointerdown", () => setTimeout(() => { box.style.opacity = 0; }, 2500), { once: true });
}

facts();
tables();
run();
explored();
details();
scene();
