// Acts on the page as a reader would, and reports what it saw. Put into the page by the test, before the page's own script.
{
  const complaints = [];
  addEventListener("error", (e) => complaints.push(String(e.message)));
  addEventListener("unhandledrejection", (e) => complaints.push(String(e.reason)));
  for (const name of ["error", "warn"]) console[name] = (...words) => complaints.push(words.join(" "));

  const wait = (ms) => new Promise((done) => setTimeout(done, ms));
  const find = (selector) => document.querySelector(selector);
  const canvas = () => find("#canvas");

  /** The canvas as small 8-bit pixels, when it is drawn finely. */
  async function picture() {
    await wait(260);
    await new Promise(requestAnimationFrame);
    const copy = document.createElement("canvas");
    [copy.width, copy.height] = [160, 120];
    const pen = copy.getContext("2d", { willReadFrequently: true });
    pen.drawImage(canvas(), 0, 0, 160, 120);
    return pen.getImageData(0, 0, 160, 120).data;
  }

  const differ = (a, b) => {
    let count = 0;
    for (let i = 0; i < a.length; i += 4) if (Math.abs(a[i] - b[i]) + Math.abs(a[i + 1] - b[i + 1]) + Math.abs(a[i + 2] - b[i + 2]) > 12) count++;
    return count > 25;
  };
  const distinct = (pixels) => {
    const colours = new Set();
    for (let i = 0; i < pixels.length; i += 4) colours.add((pixels[i] << 16) | (pixels[i + 1] << 8) | pixels[i + 2]);
    return colours.size;
  };
  const slide = (selector, value) => { const s = find(selector); s.value = value; s.dispatchEvent(new Event("input")); };
  const tick = (selector) => find(selector).click();
  const key = (name, more) => canvas().dispatchEvent(new KeyboardEvent("keydown", { key: name, bubbles: true, cancelable: true, ...more }));
  const drag = (more) => {
    const pointer = (name, x, y) => canvas().dispatchEvent(new PointerEvent(name, { pointerId: 1, clientX: x, clientY: y, bubbles: true, cancelable: true, ...more }));
    pointer("pointerdown", 300, 400); pointer("pointermove", 380, 430); pointer("pointerup", 380, 430);
  };

  async function act() {
    const acts = {};
    let before = await picture();
    const colours = distinct(before);
    const step = async (name, action) => {
      action();
      await wait(50);
      const now = await picture();
      acts[name] = differ(before, now);
      before = now;
    };
    for (const button of document.querySelectorAll("#panel [data-mode]:not(:disabled):not([aria-pressed=true])")) await step(`colour ${button.textContent}`, () => button.click());
    if (find('[data-mode="5"]')) await step("key 6", () => key("6"));
    await step("key 1", () => key("1"));
    await step("slice below", () => slide("#slice-high", 300));
    await step("slice off", () => slide("#slice-high", 1000));
    await step("slice above", () => slide("#slice-low", 600));
    slide("#slice-low", 0);
    await step("drag", () => drag({}));
    await step("shift-drag", () => drag({ shiftKey: true }));
    await step("arrow", () => key("ArrowLeft"));
    await step("zoom key", () => key("+"));
    await step("wheel", () => { canvas().focus(); canvas().dispatchEvent(new WheelEvent("wheel", { deltaY: 600, clientX: 500, clientY: 400, cancelable: true })); });
    await step("above", () => find("[data-view=top]").click());
    await wait(700);
    before = await picture();
    await step("whole", () => find("[data-view=reset]").click());
    await wait(700);
    before = await picture();
    if (find("#bend")) { await step("bend", () => slide("#bend", 0)); slide("#bend", 100); before = await picture(); }
    if (find("#exploration-step")) {
      await step("exploration", () => slide("#exploration-step", 3));
      find("#play-exploration").click();
      await wait(1500);
      acts["exploration is played"] = find("#exploration-step").value === find("#exploration-step").max;
      await step("hide exploration", () => tick("#show-exploration"));
      before = await picture();
    }
    if (find("#show-moving")) {
      await step("moving points", () => tick("#show-moving"));
      await step("moving points of a scan", () => slide("#moving-scan", 1));
      find("#play-moving").click();
      await wait(1500);
      acts["moving points are played"] = find("#moving-scan").value === find("#moving-scan").max;
      tick("#show-moving");
      before = await picture();
    }
    if (find("#show-plan")) await step("hide plan", () => tick("#show-plan"));
    await step("hide trajectory", () => tick("#show-path"));
    await step("backs", () => { tick("#show-backs"); slide("#slice-high", 700); });
    await step("theme", () => find("#theme").click());
    const chart = find("#run-charts svg");
    if (chart) {
      const box = chart.getBoundingClientRect();
      chart.dispatchEvent(new PointerEvent("pointermove", { clientX: box.left + box.width / 2, clientY: box.top + 40, bubbles: true }));
      acts["chart tells"] = [...document.querySelectorAll(".tip")].some((t) => !t.hidden && t.textContent.includes("Scan"));
      acts["top view follows"] = find("#top-view-lines > circle:last-child").getAttribute("visibility") === "visible";
    }
    const sheet = find("#top-view-walls");
    acts["top view is drawn"] = sheet.getContext("2d").getImageData(0, 0, sheet.width, sheet.height).data.some((v, i) => i % 4 === 3 && v > 60);
    return { acts, colours };
  }

  addEventListener("load", async () => {
    const seen = {};
    try {
      for (let i = 0; i < 600 && !find("#stage").dataset.ready; i++) await wait(50);
      seen.ready = find("#stage").dataset.ready || "never";
      if (seen.ready === "yes") Object.assign(seen, await act());
      else seen.message = document.querySelector(".message")?.textContent;
    } catch (error) {
      complaints.push(`the driver failed: ${error.stack}`);
    }
    Object.assign(seen, { complaints, charts: document.querySelectorAll(".chart").length, facts: document.querySelectorAll("#facts > div").length,
      rows: document.querySelectorAll("tbody tr").length, overflow: document.documentElement.scrollWidth > innerWidth + 1 });
    await fetch("REPORT_TO", { method: "POST", mode: "no-cors", body: JSON.stringify(seen) });
  });
}
