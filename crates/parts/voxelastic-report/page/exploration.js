// How a robot explored: where it was, the frontier and its plan at any moment, and what was known when.

const EXPLORED = { track: "#2aa745", frontier: "#e2702e", plan: "#2f6fe0" };
/** Points of a chart of what was known. */
const KNOWN_POINTS = 240;
/** How long a moment is shown when an exploration is played, and the longest time in which all are. */
const STEP_MS = 60, LONGEST_PLAY_MS = 30000;

/** The robot's path to a step, the frontier then as crosses that are larger where its area is, and the plan. */
function explorationSegments(index) {
  const { steps } = DATA.exploration, { position, frontier, path } = steps[index];
  const joined = (points, colour, width) => points.slice(1).map((p, i) => [points[i], p, colour, width]);
  const cross3 = ([p, area]) => {
    const arm = Math.min(Math.max(Math.sqrt(area) / 2, 0.15), 1.5);
    return [[arm, 0, 0], [0, arm, 0], [0, 0, arm]].map((d) => [sub(p, d), add(p, d), EXPLORED.frontier, 2]);
  };
  return [
    ...joined(steps.slice(0, index + 1).map((s) => s.position), EXPLORED.track, 3),
    ...frontier.flatMap(cross3),
    ...joined(path, EXPLORED.plan, 4),
    [position, add(position, [0, 0, 1]), EXPLORED.track, 6],
  ];
}

/** The moment at or before a time. */
function momentAt(time) {
  const { moments } = DATA.exploration;
  return moments.findLast((m) => m.time_s <= time + 1e-9) || moments[0];
}

/** Chooses the moment that is shown, or plays all. */
function explorationSlider(view) {
  const { steps } = DATA.exploration, last = steps.length - 1;
  const output = el("output", {});
  const input = el("input", { type: "range", min: 0, max: last, value: last, id: "exploration-step", "aria-label": "The moment of the exploration that is shown" });
  const set = (index) => {
    const { time_s: time, distance_m: distance } = steps[index], known = momentAt(time);
    input.value = index;
    output.value = `${Math.round(time)} s, ${Math.round(distance)} m${known ? `, ${short(100 * known.known_share)} %` : ""}`;
    view.showStep(index);
    view.draw();
  };
  const length = Math.min(steps.length * STEP_MS, LONGEST_PLAY_MS);
  const { button, stop } = player("play-exploration", "Plays the exploration", length, (share) => set(Math.round(share * last)));
  input.addEventListener("input", () => { stop(); set(Number(input.value)); });
  const key = Object.entries({ "where it was": EXPLORED.track, frontier: EXPLORED.frontier, plan: EXPLORED.plan });
  set(last);
  return el("fieldset", {}, el("legend", {}, "Exploration"), el("label", {}, button, input, output),
    el("div", { class: "key" }, ...key.map(([name, colour]) => el("span", { style: `--c:${colour}` }, name))));
}

/** What was known over time and distance. */
function knownCharts({ moments }) {
  const over = (key, unit, title) => {
    const end = moments.at(-1)[key];
    const values = Array.from({ length: KNOWN_POINTS }, (_, i) => {
      const at = (end * i) / (KNOWN_POINTS - 1), after = moments.findIndex((m) => m[key] >= at - 1e-9);
      const [a, b] = [moments[Math.max(after - 1, 0)], moments[after]];
      const share = b[key] > a[key] ? (at - a[key]) / (b[key] - a[key]) : 1;
      return 100 * (a.known_share + share * (b.known_share - a.known_share));
    });
    const lead = `${short(100 * moments.at(-1).known_share)} % in the end, after ${short(end)} ${unit}`;
    return chart({ title, lead, unit: "%", series: [{ name: "Known", colour: "--accent", kind: "area", values }], end, endUnit: unit });
  };
  return [over("time_s", "s", "Known space over time"), over("distance_m", "m", "Known space over distance")];
}
