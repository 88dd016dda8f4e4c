// Charts of the run: SVG, drawn anew for each width, with a cursor that all share.

const PAD = { left: 50, right: 14, top: 16, bottom: 30 };
const PHASES = [
  // Prefix of the phase's name, what it is called, colour.
  ["prepare", "Preparing the scan", "--gold"],
  ["elastic", "Submaps, loops, fusion", "--violet"],
  ["tsdf", "TSDF", "--accent"],
  ["occupancy", "Occupancy", "--sky"],
];

/**
 * A chart over the scans.
 *
 * `series`: [{name, colour, values, kind: "line" | "area" | "step", text(value)}]; areas stand on each other.
 * `marks`: scans at which something happened: [{scans, colour, name}]. `line`: a height to compare with: {at, text}.
 * `end` and `endUnit`: across is not the number of the scan but this, from 0 to `end`.
 * `nodes`: the node of each scan, where they are not those that were mapped. `remarks`: words on each scan.
 */
function chart({ title, lead, unit, series, marks = [], line, tall = 210, across, end, endUnit, nodes, remarks }) {
  const count = series[0].values.length;
  const figure = el("figure", { class: across ? "chart across" : "chart" }, el("figcaption", {}, el("h3", {}, title), el("p", {}, lead)));
  const picture = svg("svg", { role: "img", "aria-label": `${title}. ${lead}` });
  const keys = [...series.filter((s) => s.name), ...marks.filter((m) => m.scans.length)];
  figure.append(picture);
  if (keys.length > 1) figure.append(el("div", { class: "key" }, ...keys.map((k) => el("span", { style: `--c:var(${k.colour})` }, k.name))));
  const cursor = svg("g", {});
  let scale = null;
  const draw = () => {
    const width = Math.max(figure.clientWidth, 260);
    const stacked = stack(series, count);
    // A single slow scan must not make all others flat; what is cut off says so.
    const tops = stacked.flatMap((s) => (s.kind === "area" ? [] : [most(s.values)]));
    const total = stacked.filter((s) => s.kind === "area").at(-1);
    if (total) tops.push(Math.max(quantile(total.upper, 0.995) * 1.15, Math.min(most(total.upper), quantile(total.upper, 0.98) * 1.8)));
    const top = Math.max(...tops, line ? line.at * 1.12 : 0, 1e-9);
    const y = (v) => PAD.top + (tall - PAD.top - PAD.bottom) * (1 - Math.min(v / top, 1.04));
    const x = (i) => PAD.left + ((width - PAD.left - PAD.right) * i) / Math.max(count - 1, 1);
    scale = { x, y, width };
    picture.setAttribute("viewBox", `0 0 ${width} ${tall}`);
    const parts = [];
    for (const t of ticks(0, top, 4)) {
      parts.push(svg("line", { x1: PAD.left, x2: width - PAD.right, y1: y(t), y2: y(t), stroke: "var(--grid)" }));
      parts.push(svg("text", { x: PAD.left - 8, y: y(t) + 4, "text-anchor": "end" }, short(t)));
    }
    const whole = end ?? count - 1;
    for (const t of ticks(0, whole, width / 90).filter(Number.isInteger))
      parts.push(svg("text", { x: x((t / Math.max(whole, 1e-9)) * (count - 1)), y: tall - 8, "text-anchor": "middle" }, endUnit ? `${short(t)} ${endUnit}` : short(t)));
    parts.push(svg("text", { x: PAD.left - 8, y: 9, "text-anchor": "end" }, unit));
    for (const s of stacked) parts.push(shape(s, x, y, width));
    for (const mark of marks)
      for (const scan of mark.scans)
        parts.push(svg("path", { d: `M${x(Math.min(scan, count - 1))} ${tall - PAD.bottom}v6`, stroke: `var(${mark.colour})`, "stroke-width": 2 }));
    if (line && line.at <= top) {
      parts.push(svg("line", { x1: PAD.left, x2: width - PAD.right, y1: y(line.at), y2: y(line.at), stroke: "var(--ink)", "stroke-dasharray": "5 4" }));
      parts.push(svg("text", { x: width - PAD.right, y: y(line.at) - 6, "text-anchor": "end", class: "strong" }, line.text));
    }
    picture.replaceChildren(...parts, cursor);
  };
  const tip = (scan) => series.filter((s) => s.name).map((s) => `${s.name}: ${s.text ? s.text(s.values[scan]) : `${short(s.values[scan])} ${unit}`}`);
  const place = (index) => (endUnit ? `${short((end * index) / Math.max(count - 1, 1))} ${endUnit}` : `Scan ${index}`);
  const words = (scan) => [place(scan), ...tip(scan), ...(remarks && remarks[scan] ? [remarks[scan]] : [])];
  follow({ picture, cursor, count, tall, words, scale: () => scale, nodes, isAlone: Boolean(endUnit) });
  onWidth(figure, draw);
  return figure;
}

/** Adds to each area where it begins and ends. */
function stack(series, count) {
  let below = new Float64Array(count);
  return series.map((s) => {
    if (s.kind !== "area") return s;
    const lower = below, upper = below.map((v, i) => v + s.values[i]);
    below = upper;
    return { ...s, lower, upper };
  });
}

/** A series as a path; where scans are more than pixels, the largest of each few counts. */
function shape(s, x, y, width) {
  const stride = Math.max(1, Math.ceil((s.values.length / Math.max(width - PAD.left - PAD.right, 1)) * 0.8));
  const thinned = (values) => {
    const out = [];
    for (let i = 0; i < values.length; i += stride) out.push([x(Math.min(i + stride / 2, values.length - 1)), y(most(values.slice(i, i + stride)))]);
    if (out.length) { out[0][0] = x(0); out.at(-1)[0] = x(values.length - 1); }
    return out;
  };
  const text = (points) => points.map((p) => p.map((c) => c.toFixed(1)).join(" ")).join("L");
  if (s.kind === "area")
    return svg("path", { d: `M${text(thinned(s.upper))}L${text(thinned(s.lower).reverse())}Z`, fill: `var(${s.colour})`, "fill-opacity": 0.85 });
  const points = thinned(s.values);
  const d = s.kind === "step" ? points.map(([px, py], i) => (i ? `H${px.toFixed(1)}V${py.toFixed(1)}` : `M${px} ${py}`)).join("") : `M${text(points)}`;
  return svg("path", { d, fill: "none", stroke: `var(${s.colour})`, "stroke-width": 1.8, "stroke-linejoin": "round" });
}

/** Shows what is under the pointer, and updates the other charts and the top view. */
function follow({ picture, cursor, count, tall, words, scale, nodes, isAlone }) {
  // Scans are known to the other charts by their place among those that were mapped.
  const mapped = nodes && new Map(DATA.run.scans.node.map((node, i) => [node, i]));
  const shared = (scan) => (isAlone ? null : nodes ? mapped.get(nodes[scan]) ?? null : scan);
  const own = (scan) => (nodes ? nodes.indexOf(DATA.run.scans.node[scan]) : scan);
  const tip = el("div", { class: "tip", hidden: true });
  document.body.append(tip);
  const mark = (scan) => {
    cursor.replaceChildren();
    if (scan === null || !scale()) return;
    const at = scale().x(scan);
    cursor.append(svg("line", { x1: at, x2: at, y1: PAD.top, y2: tall - PAD.bottom, stroke: "var(--ink)", "stroke-opacity": 0.45 }));
  };
  picture.addEventListener("pointermove", (e) => {
    const box = picture.getBoundingClientRect();
    if (!scale()) return;
    const { width } = scale();
    const share = (((e.clientX - box.left) / box.width) * width - PAD.left) / (width - PAD.left - PAD.right);
    const scan = Math.round(Math.min(Math.max(share, 0), 1) * (count - 1));
    tip.replaceChildren(...words(scan).flatMap((w) => [w, el("br")]));
    tip.hidden = false;
    tip.style.left = `${Math.min(e.clientX + 16, innerWidth - tip.offsetWidth - 8)}px`;
    tip.style.top = `${e.clientY + 18}px`;
    pointed.at(shared(scan), picture);
    mark(scan);
  });
  picture.addEventListener("pointerleave", () => { tip.hidden = true; pointed.at(null, picture); });
  if (!isAlone) pointed.listeners.push((scan) => {
    const at = scan === null ? -1 : own(scan);
    mark(at >= 0 && at < count ? at : null);
  });
}

/** The charts of a run. */
function runCharts(run) {
  const { scans, phases_ms: phases } = run;
  const out = [];
  if (scans.wall_ms.length) out.push(timeChart(run));
  if (Object.keys(phases).length) out.push(phaseBars(phases));
  if (run.registrations.node.length) out.push(registrationChart(run.registrations));
  if (run.registrations.sigma_m.some((sigma) => sigma > 0)) out.push(driftChart(run.registrations));
  const corrections = run.corrections.map((c) => c.after);
  if (scans.map_mb.length) {
    const series = [{ name: "Map", colour: "--accent", kind: "area", values: scans.map_mb }];
    if (scans.rss_mb.length) series.push({ name: "Process", colour: "--warm", kind: "line", values: scans.rss_mb });
    out.push(chart({ title: "Memory", lead: `map ${short(scans.map_mb.at(-1))} MB in the end`, unit: "MB", series }));
  }
  if (scans.submaps.length) {
    const values = scans.submaps;
    const marks = [{ name: "Corrections of the poses", colour: "--warm", scans: corrections }];
    const series = [{ name: "Submaps", colour: "--violet", kind: "step", values, text: String }];
    const lead = `${DATA.surfaces.length || values.at(-1)} in the end${run.fusions ? `, ${run.fusions} fused into others` : ""}`;
    out.push(chart({ title: "Submaps", lead, unit: "", series, marks }));
  }
  return out;
}

/** How well each raw scan fits the scans before it. */
function registrationChart({ node, score, overlap, remark }) {
  const lost = remark.flatMap((words, scan) => (words && score[scan] === 0 ? [scan] : []));
  const said = remark.flatMap((words, scan) => (words && score[scan] > 0 ? [scan] : []));
  const fits = score.filter((s) => s > 0);
  const lead = `median score ${short(quantile(fits.length ? fits : [0], 0.5))}; ` +
    `${lost.length ? `${lost.length} of ${node.length} scans not registered` : `all ${node.length} scans registered`}`;
  const series = [
    { name: "Score, 1 where all surfaces lie on the map's", colour: "--accent", kind: "line", values: score, text: short },
    { name: "Share of the surfaces that are in the map", colour: "--soft", kind: "line", values: overlap, text: short },
  ];
  const marks = [{ name: "Not registered", colour: "--rose", scans: lost }, { name: "Something to say", colour: "--warm", scans: said }];
  return chart({ title: "Odometry", lead, unit: "", series, marks, nodes: node, remarks: remark });
}

/** How wrong the odometry's positions can have become, as it estimates that itself. */
function driftChart({ node, sigma_m: sigma }) {
  const last = sigma.findLast((s) => s > 0);
  const series = [{ name: "Standard deviation of the position since the first scan of its piece, without closures", colour: "--accent", kind: "area", values: sigma }];
  return chart({ title: "Drift", lead: `${short(last)} m in the end, as the odometry estimates it`, unit: "m", series, nodes: node });
}

/** Time of each scan, by part, with the time between two scans of the sensor (paper Fig. 2). */
function timeChart({ scans, phases_ms: phases }) {
  const parts = PHASES.map(([prefix, name, colour]) => {
    const columns = Object.entries(phases).filter(([key]) => key === prefix || key.startsWith(prefix + "_")).map(([, column]) => column);
    return { name, colour, kind: "area", values: scans.wall_ms.map((_, i) => columns.reduce((sum, c) => sum + c[i], 0)), any: columns.length > 0 };
  }).filter((p) => p.any && most(p.values) > 0.005);
  const rest = scans.wall_ms.map((ms, i) => Math.max(ms - parts.reduce((sum, p) => sum + p.values[i], 0), 0));
  if (mean(rest) > 0.02 * mean(scans.wall_ms)) parts.push({ name: "Other", colour: "--soft", kind: "area", values: rest });
  const period = DATA.sensor_period_ms;
  const inTime = scans.wall_ms.filter((ms) => ms <= period).length / scans.wall_ms.length;
  const lead = `median ${short(quantile(scans.wall_ms, 0.5))} ms, 95 % within ${short(quantile(scans.wall_ms, 0.95))} ms; ` +
    `${Math.floor(inTime * 100)} % faster than the sensor`;
  const line = { at: period, text: `a scan every ${short(period)} ms` };
  return chart({ title: "Integration time of each scan", lead, unit: "ms", series: parts, line, tall: 270, across: true });
}

/** Mean time of every phase. */
function phaseBars(phases) {
  const rows = Object.entries(phases).map(([key, values]) => {
    const [, , colour] = PHASES.find(([prefix]) => key === prefix || key.startsWith(prefix + "_")) || ["", "", "--soft"];
    return { key, colour, mean: mean(values), p95: quantile(values, 0.95) };
  }).filter((r) => r.mean >= 0.005).sort((a, b) => b.mean - a.mean);
  const total = rows.reduce((sum, r) => sum + r.mean, 0);
  const figure = el("figure", { class: "chart" }, el("figcaption", {}, el("h3", {}, "Where the time goes"), el("p", {}, `mean ${short(total)} ms a scan`)));
  const high = 23, tall = rows.length * high + 4, picture = svg("svg", { role: "img", "aria-label": `Mean time by phase, in all ${short(total)} ms` });
  const draw = () => {
    const width = Math.max(figure.clientWidth, 260), left = 150, room = width - left - 118, longest = rows[0] ? rows[0].mean : 1;
    picture.setAttribute("viewBox", `0 0 ${width} ${tall}`);
    picture.replaceChildren(...rows.flatMap((r, i) => {
      const y = i * high, long = Math.max((r.mean / longest) * room, 1);
      return [
        svg("text", { x: left - 10, y: y + 15, "text-anchor": "end" }, r.key.replace("_", ": ")),
        svg("rect", { x: left, y: y + 4, width: long, height: high - 9, rx: 3, fill: `var(${r.colour})` }),
        svg("text", { x: left + long + 7, y: y + 15 }, svg("tspan", { class: "strong" }, short(r.mean)), ` (95 %: ${short(r.p95)})`),
      ];
    }));
  };
  figure.append(picture);
  onWidth(figure, draw);
  return figure;
}

/** Distances from the truth: shares by centimetre, and how many are within (paper Fig. 5). */
function errorChart({ name, stats }, colour) {
  const { bin_m: bin, counts } = stats.histogram;
  const shares = counts.map((c) => (100 * c) / Math.max(stats.count, 1));
  const within = shares.map(((sum) => (s) => (sum += s))(0));
  const enough = within.findIndex((w) => w > 98.5);
  const last = enough < 0 ? counts.length : Math.min(counts.length, Math.max(10, enough + 2));
  const cm = (m) => (m === null || m === undefined ? "–" : `${short(m * 100)} cm`);
  const lead = `mean ${cm(stats.mean)}, median ${cm(stats.median)}, 90 % within ${cm(stats.p90)}`;
  const figure = el("figure", { class: "chart" }, el("figcaption", {}, el("h3", {}, name), el("p", {}, lead)));
  const picture = svg("svg", { role: "img", "aria-label": `${name}: ${lead}` }), tall = 220;
  const draw = () => {
    const width = Math.max(figure.clientWidth, 260), right = 40;
    const x = (i) => PAD.left + ((width - PAD.left - right) * i) / last, top = most(shares) * 1.05 || 1;
    const y = (v) => PAD.top + (tall - PAD.top - PAD.bottom) * (1 - v / top), yy = (v) => y((v / 100) * top);
    const parts = ticks(0, top, 4).flatMap((t) => [
      svg("line", { x1: PAD.left, x2: width - right, y1: y(t), y2: y(t), stroke: "var(--grid)" }),
      svg("text", { x: PAD.left - 8, y: y(t) + 4, "text-anchor": "end" }, `${short(t)} %`)]);
    for (let i = 0; i < last; i++)
      parts.push(svg("rect", { x: x(i) + 0.5, width: Math.max(x(i + 1) - x(i) - 1, 0.5), y: y(shares[i]), height: y(0) - y(shares[i]), fill: `var(${colour})` }));
    const curve = within.slice(0, last).map((w, i) => `${x(i + 1).toFixed(1)} ${yy(w).toFixed(1)}`);
    parts.push(svg("path", { d: `M${x(0)} ${yy(0)}L${curve.join("L")}`, fill: "none", stroke: "var(--ink)", "stroke-width": 1.5 }));
    for (const share of [50, 90, 100]) parts.push(svg("text", { x: width - right + 6, y: yy(share) + 4 }, `${share} %`));
    for (const t of ticks(0, last * bin * 100, 6)) parts.push(svg("text", { x: x(t / 100 / bin), y: tall - 8, "text-anchor": "middle" }, `${short(t)} cm`));
    picture.setAttribute("viewBox", `0 0 ${width} ${tall}`);
    picture.replaceChildren(...parts);
  };
  figure.append(picture);
  onWidth(figure, draw);
  return figure;
}
