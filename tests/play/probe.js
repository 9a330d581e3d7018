// What browser.py asks of the page.
globalThis.probe = {
  /** What changes with the load: it, what its handles say, and where it is much of a change the motion and the sentence. */
  seen: () => [
    String(aminnPlay.at.load),
    ["force", "moment"].map((id) => document.getElementById(id).getAttribute("aria-valuetext")).join(),
    ...["moves", "sentence"].map((id) => document.getElementById(id).textContent),
  ],

  /** The picture shows the load that is set. */
  settled: () => String(aminnPlay.at.load) === String(aminnPlay.shown().load),

  /** What changes when the view turns. */
  view: () => document.getElementById("force").getAttribute("transform"),

  options: (id) => [...document.querySelectorAll(`#${id} option`)].map((option) => option.value),

  choose(id, value) {
    const select = document.getElementById(id);
    select.value = value;
    select.dispatchEvent(new Event("change"));
  },

  /** Controls in sight that a screen reader has no name for. */
  unnamed() {
    const controls = [...document.querySelectorAll("input, select, button, [role=slider], [role=img]")];
    const named = (control) => control.labels?.length || control.getAttribute("aria-label") || control.textContent.trim();
    return controls.filter((control) => control.checkVisibility() && !named(control)).map((control) => control.outerHTML);
  },

  /** Names of fingers that lie on each other. */
  overlaps() {
    const boxes = [...document.querySelectorAll("#overlay text.name")].map((text) => [text, text.getBoundingClientRect()]);
    const apart = (a, b) => a.right <= b.left || b.right <= a.left || a.bottom <= b.top + 3 || b.bottom <= a.top + 3;
    return boxes.flatMap(([one, a], i) =>
      boxes.slice(i + 1).filter(([, b]) => !apart(a, b)).map(([other]) => `${one.textContent} and ${other.textContent}`));
  },

  /** The result file of a vector file, both base64, by the first model. */
  replay(vectors) {
    const { result } = aminnPlay.models[0].replay(Uint8Array.from(atob(vectors), (c) => c.charCodeAt(0)));
    return btoa(Array.from(result, (byte) => String.fromCharCode(byte)).join(""));
  },
};
