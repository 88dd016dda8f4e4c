// The panels: tools, numbers of what is selected, the edit that is tried, measures, comparison; suggestions, closures and edits.

/** Rows of a list that are shown. */
const ROWS = 100;

const button = (id, text, title, act) => el("button", { type: "button", id, title, onclick: act }, text);
const field = (legend, id, ...children) => el("fieldset", { id }, el("legend", {}, legend), ...children);
const number = (id, text, step, act) => el("label", {}, text, el("input", { type: "number", id, step, oninput: act }));
const choice = (id, text, values, act) => el("label", {}, text, el("select", { id, onchange: act }, ...values.map((v) => el("option", { value: v }, v))));

/** Fills both panels; `editor` does what is asked for. */
function editPanels(view, editor) {
  const { show } = view;
  const colours = COLOURS.map((colour, mode) => colour && el("button", {
    type: "button", "data-mode": mode, "aria-pressed": String(mode === show.mode), title: `Colour by ${colour.name.toLowerCase()} (${mode + 1})`,
    onclick: () => {
      show.mode = mode;
      colours.forEach((b, i) => b?.setAttribute("aria-pressed", i === mode));
      view.draw();
    },
  }, colour.name));
  const box = (key, text) => el("label", {}, el("input", {
    type: "checkbox", checked: show[key], id: `show-${key}`, onchange: (e) => { show[key] = e.target.checked; view.draw(); },
  }), text);
  const place = () => editor.typed();
  byId("panel").append(
    el("div", { class: "choices", id: "steps" }, button("undo", "Undo", "Take the last edit back (Ctrl+Z)", () => editor.ask("undo")),
      button("redo", "Redo", "Do it again (Ctrl+Y)", () => editor.ask("redo")),
      button("save", "Save", "Write the edits (Ctrl+S): nothing is written before", () => editor.ask("save"))),
    el("p", { id: "words", role: "status" }),
    field("Tool", "tools", el("div", { class: "choices" }, ...TOOLS.map(({ name, text, title }) => el("button", {
      type: "button", "data-tool": name, title, "aria-pressed": String(name === "move"), onclick: () => editor.tools.choose(name) }, text)))),
    field("Selected", "selected", el("p", { id: "which" }), el("div", { class: "numbers" }, number("x", "x", 0.05, place), number("y", "y", 0.05, place),
      number("z", "z", 0.05, place), number("turn", "turn °", 0.5, place))),
    field("Erase", "erase", el("div", { class: "numbers" }, number("low", "from z", 0.1, () => editor.erase()), number("high", "to z", 0.1, () => editor.erase()),
      choice("of", "of", ["both", "surfaces", "occupancy"], () => editor.erase()), choice("then", "then", ["unknown", "free"], () => editor.erase())),
      el("label", {}, el("input", { type: "checkbox", id: "only", onchange: () => editor.erase() }), "of the selected submap only")),
    field("Tried, not taken yet", "trial", el("table", { id: "fits" }), el("div", { class: "choices" },
      button("accept", "Accept ⏎", "Take it (Enter)", () => editor.ask("accept")), button("discard", "Drop", "Drop it (Escape)", () => editor.ask("discard")),
      el("button", { type: "button", id: "before", "aria-pressed": "false", title: "Show the map before it (B)", onclick: () => editor.compare() }, "Before"))),
    field("Measure", "measure", el("p", { id: "measure-help" }, "Click points on surfaces; with the keys, arrows turn the picture and Enter takes what is under the cross."),
      el("dl", { id: "measures", "aria-live": "polite" }), el("div", { class: "choices" }, button("unmeasure", "Last point back", "Takes the last point back (Backspace)", () => editor.measure.back()),
        button("remeasure", "Clear", "Begins again (Escape)", () => editor.measure.clear()))),
    field("Compare with the saved map", "compare", el("div", { class: "choices" },
      el("button", { type: "button", id: "saved-map", "aria-pressed": "false", title: "Show the map as it is saved, and again with the edits (V)", onclick: () => editor.compareSaved() }, "Saved map"),
      el("button", { type: "button", id: "difference", "aria-pressed": "false", title: "Colour what the edits change (E)", onclick: () => editor.showChanges() }, "Difference")),
      el("p", { id: "changed" })),
    field("Colour", "colours", el("div", { class: "choices" }, ...colours.filter(Boolean))),
    field("Show", "layers", box("path", "Trajectory"), box("loops", "Closures"), box("backs", "Backs of surfaces: roofs, ceilings")),
    el("div", { class: "choices" }, button("picture", "Save a picture", "What is seen, as PNG (P)", () => editor.picture())));
  byId("panel").addEventListener("submit", (e) => e.preventDefault());
  const list = (id, title, ...more) => [el("h2", { id: `${id}-title` }, title), ...more, el("ol", { class: "rows", id, "aria-labelledby": `${id}-title` })];
  byId("lists").append(
    ...list("suggestions", "Suggestions", el("div", { class: "choices" }, button("look", "Look for some", "Compares the surfaces of all submaps, and tries what may mend them", () => editor.ask("suggest")),
      button("next", "Next", "Goes to the next one and tries its edit (N)", () => editor.nextSuggestion()))),
    ...list("closures", "Closures"), ...list("edits", "Edits"));
  const acts = { reset: () => view.reset(), top: () => view.top() };
  document.querySelectorAll("[data-view]").forEach((b) => b.addEventListener("click", () => acts[b.dataset.view]()));
  onTheme.push(() => { view.stale = true; view.draw(); });
  return () => colours.forEach((b, i) => b && (b.hidden = Boolean(COLOURS[i].flag) && !(view.flags & COLOURS[i].flag)));
}

/** What the lists have. */
function showLists(view, editor, { closures, suggestions, suggestions_are_old, edits, saved }) {
  const off = !editor.mayEdit();
  const middle = ([a, b]) => scaled(add(a, b), 0.5);
  byId("closures-title").textContent = closures.length ? `Closures (${closures.length}), the most suspicious first` : "No closures";
  byId("closures").replaceChildren(...closures.slice(0, ROWS).map(({ scans, off_m, ends }, i) => el("li", {
    onpointerenter: () => { view.pointed = i; view.stale = true; view.draw(); }, onpointerleave: () => { view.pointed = -1; view.stale = true; view.draw(); },
  }, el("i", { style: `--c:${offColour(off_m)}` }), el("button", { type: "button", class: "go", title: "Go there", onclick: () => view.lookAtPlace(middle(ends)) },
    `${scans[0]} – ${scans[1]} `, el("small", {}, `${off_m.toFixed(3)} m off`)),
  el("button", { type: "button", disabled: off, "data-scans": scans.join(" "), "aria-label": `Remove the closure of scans ${scans.join(" and ")}`,
    onclick: () => editor.attempt(`kind = "remove-closure"\nscans = [${scans}]`) }, "Remove"))));
  const old = suggestions_are_old ? ": of the map before the last edit" : "";
  byId("suggestions-title").textContent = suggestions === null ? "Suggestions" : suggestions.length ? `Suggestions (${suggestions.length})${old}` : "Nothing is inconsistent";
  byId("suggestions").replaceChildren(...(suggestions || []).slice(0, ROWS).map((one, i) => el("li", { "aria-current": i === editor.suggested ? "true" : null },
    el("button", { type: "button", class: "go", title: "Go there", onclick: () => editor.goTo(i) }, `${one.text} `, el("small", {}, agreement(one))),
    el("button", { type: "button", disabled: off, "data-suggestion": i, "aria-label": `Try: ${one.text}`, title: one.edit, onclick: () => editor.trySuggestion(i) }, "Try"))));
  byId("edits-title").textContent = edits.length ? `Edits (${edits.length})` : "No edits";
  byId("edits").replaceChildren(...edits.map(({ kind, text }, k) => el("li", { title: text }, el("span", {}, `${k + 1}. ${kind} `,
    el("small", {}, k < saved ? "" : "not saved")))));
}

/** How many places on surfaces agree if a suggestion is followed. */
function agreement({ places_agree: agree }) {
  return agree ? `${agree[0].toLocaleString("en")} places agree, ${agree[1].toLocaleString("en")} with it` : "";
}

/** The edit that is tried: how two submaps fit before and after. */
function showTrial(trial) {
  byId("trial").hidden = !trial;
  byId("fits").hidden = !trial?.fits;
  if (!trial?.fits) return;
  const row = (name, { places, matched, apart_m }) => el("tr", {}, el("th", { scope: "row" }, name), el("td", {}, `${Math.round(100 * matched)} % of ${places}`),
    el("td", {}, `${(100 * apart_m).toFixed(1)} cm`));
  byId("fits").replaceChildren(el("tr", {}, el("th", {}, ""), el("th", { scope: "col" }, "places agree"), el("th", { scope: "col" }, "apart")),
    row("before", trial.fits[0]), row("after", trial.fits[1]));
}
