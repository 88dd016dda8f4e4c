// Points on things that moved: hidden, all of them, or those of a few scans, which are played.

/** Scans before the chosen one whose points are shown, too, and how long a scan is shown when they are played. */
const TRAIL = 4, SCAN_MS = 100, LONGEST_MS = 20000;

/** Segments that show the points of `moving[first]` to `moving[last]`, where their submaps are now. */
function movingSegments(poses, first, last) {
  const segments = [], colour = themed("--warm");
  for (const { submap, coordinates } of DATA.moving.slice(first, last + 1)) {
    const s = poses.get(submap);
    for (let i = 0; s && i < coordinates.length; i += 3) {
      const p = moved(s.now, coordinates.slice(i, i + 3));
      segments.push([p, add(p, [0, 0, 0.04]), colour, 3]);
    }
  }
  return segments;
}

/** Chooses the scan whose moving points are shown, or plays all. */
function movingSlider(view) {
  const count = DATA.moving.length;
  const output = el("output", {}, "all");
  const input = el("input", { type: "range", min: 0, max: count, value: count, id: "moving-scan", "aria-label": "The scan whose moving points are shown" });
  const set = (index) => {
    input.value = index;
    output.value = index < count ? `scan ${scanOf(DATA.moving[index].node)}` : "all";
    view.showMoving(index < count ? [index - TRAIL, index] : [0, count - 1]);
    view.draw();
  };
  const shown = () => { if (!view.show.moving) byId("show-moving").click(); };
  const { button, stop } = player("play-moving", "Plays the scans", Math.min(count * SCAN_MS, LONGEST_MS), (share) => {
    shown();
    set(Math.min(Math.floor(share * count), count));
  });
  input.addEventListener("input", () => { stop(); shown(); set(Number(input.value)); });
  return el("fieldset", {}, el("legend", {}, "Things that moved"), el("label", {}, button, input, output));
}

/** The number of the scan of a node in the charts of the run, if there is one. */
function scanOf(node) {
  const scan = DATA.run ? DATA.run.scans.node.indexOf(node) : -1;
  return scan < 0 ? node : scan;
}
