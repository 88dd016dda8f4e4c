// The editor: what is asked of the server, one thing after the other, and what it tells.

/** What the server tells after it was asked comes within this time, ms, or never: also to a page that draws slowly. */
const UPDATE_TIMEOUT = 60000;
/** The status of an answer to what the map refuses. */
const REFUSED = 409;

class MapEditor {
  constructor(view) {
    // `seen.drags` are the times from a movement of the pointer to the picture of what it did, ms.
    Object.assign(this, { view, token: location.hash.slice(1), figures: null, wanted: null, running: null, turn: Promise.resolve(), before: null, pose: null, seen: { drags: [], tries: 0 } });
    this.tools = new Tools(view, {
      chosen: () => this.select(this.tools.isErasing() ? this.view.selected : []), select: (id) => this.select(id === null ? [] : [id]), pair: (id) => this.pair(id), mayMove: () => this.mayEdit(),
      moved: (pose) => this.moveTo(pose), outlined: (polygon) => this.outlined(polygon), measured: (point) => this.measurePoint(point),
    });
    this.measure = new Measure(view);
    this.suggested = -1;
    addEventListener("keydown", (e) => this.key(e));
    addEventListener("beforeunload", (e) => { if (this.figures && !this.figures.is_saved) e.preventDefault(); });
  }

  mayEdit() { return Boolean(this.token && this.figures && !this.figures.read_only); }

  say(words, refused) {
    byId("words").dataset.state = refused ? "refused" : "done";
    byId("words").textContent = words;
  }

  /** Asks the server, one thing after the other. */
  post(name, body) {
    this.turn = this.turn.then(() => this.asked(name, body));
    return this.turn;
  }

  /** Resolves when the page knows what the request changed, too, which the socket tells, perhaps after the answer. */
  async asked(name, body) {
    const updated = new Promise((done) => { this.updated = done; });
    try {
      const answer = await fetch(`/edit/${name}`, { method: "POST", headers: { Authorization: `Bearer ${this.token}` }, body });
      const words = (await answer.text()).trim();
      if (answer.ok || answer.status === REFUSED) await Promise.race([updated, new Promise((done) => { setTimeout(done, UPDATE_TIMEOUT); })]);
      this.say(words, !answer.ok);
      return answer.ok;
    } catch {
      this.say("the editor does not answer", true);
      return false;
    }
  }

  /** Tries an edit; of those that come while one is tried only the last is. `at` is when the pointer moved. */
  attempt(edit, at = 0) {
    const { view } = this;
    if (!edit.includes('"erase"')) view.region = null;
    if (!at) Object.assign(view, { local: null, instead: null });
    this.wanted = { edit, at };
    this.running ??= (async () => {
      while (this.wanted) {
        const { edit: next, at: moved } = this.wanted;
        this.wanted = null;
        this.seen.moved = moved;
        this.seen.tries++;
        if (!moved) this.say("trying …");
        if (!(await this.post("try", `[[edit]]\n${next}\n`))) this.letGo();
      }
      this.running = null;
    })();
    return this.running;
  }

  /** After what is tried: takes or drops it, undoes, does again, saves, looks for suggestions, shows the saved map. */
  async ask(name) {
    if (!this.mayEdit()) return;
    await this.running;
    if (name === "suggest") {
      this.suggested = -1;
      this.say("looking …");
    }
    if (await this.post(name, "") && name === "discard") this.letGo();
    if (name === "accept") this.view.region = null;
    this.view.stale = true;
    this.view.draw();
  }

  /** What the pointer or the numbers have moved is where the server has it. */
  letGo() {
    Object.assign(this.view, { local: null, region: null });
    this.view.arrange();
    this.numbers();
    this.view.draw();
  }

  select(ids) {
    const { view } = this;
    Object.assign(view, { selected: ids, local: null, gizmo: ids.length === 1 && this.tools.tool === "move" ? new Gizmo(view, ids[0]) : null, region: null, stale: true });
    this.pose = view.serverPoses.get(ids[0]);
    view.arrange();
    this.numbers();
    view.draw();
  }

  pair(id) {
    const { selected } = this.view;
    if (id === null) return this.select([]);
    this.select(selected.length === 1 && selected[0] !== id ? [selected[0], id] : [id]);
    if (this.view.selected.length === 2) this.register();
  }

  /** Registers the two that are selected: from where they are shown, if one was dragged there and that was not taken. */
  register() {
    const { view } = this, [a, b] = view.selected.map((id) => view.serverPoses.get(id));
    const start = () => [...movedBack(a, b.slice(0, 3)), ...turnedBy([...scaled(a.slice(3, 6), -1), a[6]], b.slice(3))];
    const from = this.figures?.trial?.kind === "pin" ? `\nstart = [${start()}]` : "";
    if (this.mayEdit()) this.attempt(`kind = "closure"\nsubmaps = [${view.selected}]${from}`);
  }

  /** The submap is held at a pose, and the graph follows. */
  moveTo(pose, at = performance.now()) {
    const { view } = this, submap = view.selected[0], { origin } = this.figures;
    Object.assign(view, { local: { submap, pose }, instead: null });
    view.arrange();
    this.numbers();
    view.draw();
    const numbers = [...add(pose.slice(0, 3), origin), ...pose.slice(3)];
    this.attempt(`kind = "pin"\nsubmap = ${submap}\npose = [${numbers}]`, at);
  }

  /** Numbers that were typed move it, too. */
  typed() {
    const texts = ["x", "y", "z", "turn"].map((id) => byId(id).value), [x, y, z, turn] = texts.map(Number);
    if (texts.includes("") || !this.pose || !this.mayEdit()) return;
    this.moveTo([...sub([x, y, z], this.figures.origin), ...turnedPose(this.pose, (turn * Math.PI) / 180).slice(3)]);
  }

  /** Goes to what a suggestion is about. */
  goTo(i) {
    const one = this.figures.suggestions[i];
    this.suggested = i;
    this.select(one.submaps.slice(0, 2));
    this.view.lookAtPlace(sub(one.at, this.figures.origin));
    showLists(this.view, this, this.figures);
    document.querySelector('#suggestions [aria-current="true"]')?.scrollIntoView({ block: "nearest" });
  }

  /** Goes there and tries its edit. */
  trySuggestion(i) {
    this.goTo(i);
    if (this.mayEdit()) this.attempt(this.figures.suggestions[i].edit.replace("[[edit]]", "").trim());
  }

  /** The next suggestion, from the first again after the last one; looks for some if nobody has. */
  async nextSuggestion() {
    if (!this.figures?.suggestions || this.figures.suggestions_are_old) await this.ask("suggest");
    const count = this.figures?.suggestions?.length || 0;
    if (count) this.trySuggestion((this.suggested + 1) % count);
  }

  measurePoint(point) {
    this.measure.origin = this.figures?.origin;
    if (!this.measure.add(point)) this.say("no surface is there", true);
  }

  /** Shows the map on the disk, or with the edits again. */
  compareSaved() { this.ask(this.figures?.shows_saved ? "draft" : "saved"); }

  /** Colours what the edits change. */
  showChanges() {
    const { view } = this;
    view.show.changes = !view.show.changes;
    byId("difference").setAttribute("aria-pressed", String(view.show.changes));
    view.draw();
  }

  showCompared({ changes, shows_saved }) {
    this.view.changes = new Map(changes.map((change) => [change.submap, change]));
    byId("saved-map").setAttribute("aria-pressed", String(shows_saved));
    const far = most([0, ...changes.map(({ moved_m }) => moved_m)]), others = changes.filter(({ has_changed }) => has_changed).length;
    const words = [far ? `moved by up to ${far.toFixed(3)} m` : "", others ? `${others} with something erased or merged` : ""].filter(Boolean).join(", ");
    byId("changed").textContent = changes.length ? `${changes.length} submaps are others: ${words}` : "The same";
  }

  picture() { return this.view.savePicture(document.querySelector("#panel h1").textContent); }

  /** The numbers of what is selected. */
  numbers() {
    const { view } = this, [id] = view.selected, pose = view.submaps.get(id), { tool } = this.tools;
    byId("selected").hidden = tool !== "move" && tool !== "closure";
    byId("erase").hidden = !this.tools.isErasing();
    byId("measure").hidden = byId("aim").hidden = tool !== "measure";
    const help = tool === "closure" ? "Click two submaps that saw the same place" : "Click a submap";
    byId("which").textContent = view.selected.length === 2 ? `Submaps ${view.selected.join(" and ")}` : pose ? `Submap ${id}` : help;
    document.querySelector("#selected .numbers").hidden = view.selected.length !== 1 || tool !== "move";
    if (!pose || !this.pose) return;
    const set = (name, value, digits) => { if (document.activeElement !== byId(name)) byId(name).value = value.toFixed(digits); };
    add(pose.slice(0, 3), this.figures.origin).forEach((c, k) => set("xyz"[k], c, 3));
    const [, , z, w] = turnedBy(pose.slice(3), [...scaled(this.pose.slice(3, 6), -1), this.pose[6]]);
    set("turn", (((2 * Math.atan2(z, w) * 180) / Math.PI + 540) % 360) - 180, 2);
  }

  outlined(polygon) {
    const { view } = this, { origin } = this.figures;
    if (!byId("low").value) byId("low").value = (view.bounds.low[2] + origin[2] - 5).toFixed(1);
    if (!byId("high").value) byId("high").value = (view.bounds.high[2] + origin[2] + 5).toFixed(1);
    view.region = { polygon, z: [0, 0] };
    this.erase();
  }

  /** Tries to erase what is outlined. */
  erase() {
    const { view } = this, { origin } = this.figures || {};
    if (!view.region || !this.mayEdit()) return;
    const z = ["low", "high"].map((id) => Number(byId(id).value)), of = byId("of").value;
    view.region.z = z.map((c) => c - origin[2]);
    view.stale = true;
    view.draw();
    const corners = view.region.polygon.map(([x, y]) => `[${x + origin[0]}, ${y + origin[1]}]`);
    const only = byId("only").checked && view.selected.length ? `\nsubmaps = [${view.selected}]` : "";
    const then = of === "surfaces" ? "" : `\nthen = "${byId("then").value}"`;
    this.attempt(`kind = "erase"\nprism = { polygon = [${corners}], z = [${z}] }\nof = "${of}"${then}${only}`);
  }

  /** Shows the map before what is tried, or with it again. */
  compare() {
    const { view } = this;
    view.instead = view.instead || !this.figures?.trial ? null : this.before;
    byId("before").setAttribute("aria-pressed", String(Boolean(view.instead)));
    const { local } = view;
    if (view.instead) view.local = null;
    view.arrange();
    if (!view.instead) view.local = local;
    view.draw();
  }

  key(e) {
    const isTyping = ["INPUT", "SELECT"].includes(document.activeElement?.tagName), control = e.ctrlKey || e.metaKey, key = e.key.toLowerCase();
    if (control && key === "z") this.ask(e.shiftKey ? "redo" : "undo");
    else if (control && key === "y") this.ask("redo");
    else if (control && key === "s") this.ask("save");
    else if (control || e.altKey) return;
    else if (this.tools.tool === "measure" && document.activeElement === this.view.canvas && ["enter", "backspace", "escape"].includes(key) && !this.figures?.trial) {
      const { clientWidth: w, clientHeight: h } = this.view.canvas;
      if (key === "enter") this.measurePoint(this.view.pick(w / 2, h / 2));
      else this.measure[key === "escape" ? "clear" : "back"]();
    } else if (key === "enter" && this.figures?.trial && document.activeElement?.tagName !== "BUTTON") this.ask("accept");
    else if (key === "escape") this.figures?.trial ? this.ask("discard") : this.select([]);
    else if (!isTyping && key === "b") this.compare();
    else if (!isTyping && key === "v") this.compareSaved();
    else if (!isTyping && key === "e") this.showChanges();
    else if (!isTyping && key === "p") this.picture();
    else if (!isTyping && key === "n") this.nextSuggestion();
    else if (!isTyping && TOOLS.some((tool) => tool.key === key)) this.tools.choose(TOOLS.find((tool) => tool.key === key).name);
    else return;
    e.preventDefault();
  }

  /** What the server tells. */
  show(figures) {
    const { view } = this, wasTried = this.figures?.trial;
    this.figures = figures;
    byId("figures").replaceChildren(...figures.rows.flatMap(([name, value]) => [el("dt", {}, name), el("dd", {}, value)]));
    if (!figures.trial) {
      this.before = new Map(view.serverPoses);
      Object.assign(view, { local: null, instead: null, region: null });
      if (wasTried) this.pose = view.serverPoses.get(view.selected[0]);
    }
    // The picture of what the pointer did is the next one.
    [view.asked, this.seen.moved] = [this.seen.moved || 0, 0];
    Object.assign(view, { closures: figures.closures, stale: true });
    view.arrange();
    this.numbers();
    showTrial(figures.trial);
    this.showCompared(figures);
    showLists(view, this, figures);
    const off = !this.mayEdit();
    document.querySelectorAll("#steps button, #tools button, #selected input, #erase input, #erase select, #look, #next, #saved-map").forEach((b) => { b.disabled = off; });
    byId("undo").disabled ||= figures.edits.length === 0;
    byId("redo").disabled ||= figures.redo === 0;
    byId("save").disabled ||= figures.is_saved;
    this.updated?.();
    view.draw();
    if (figures.read_only) this.say(`${figures.read_only}: the page shows it as it is`, true);
    else if (!this.token) this.say("Read-only: open the whole address that the program printed, whose token is behind the #", true);
  }
}

let showFigures = () => {};
try {
  const view = new EditView(byId("canvas"));
  const editor = new MapEditor(view);
  const offerColours = editPanels(view, editor);
  steer(view);
  showFigures = (figures) => editor.show(figures);
  showTrial(null);
  editor.numbers();
  offerColours();
  view.draw();
  const seen = connect(view, offerColours), finished = view.finished;
  view.finished = (took) => {
    if (view.drawn_for) editor.seen.drags.push(performance.now() - view.drawn_for);
    view.drawn_for = 0;
    finished(took);
  };
  // For tests and for the curious: what is there, in the console.
  window.voxelastic = { view, seen, editor };
} catch (error) {
  byId("state").dataset.state = "lost";
  byId("state").textContent = `The map cannot be shown in 3D: ${error.message}. A current Firefox, Chrome or Safari can.`;
}
