/** A line of what happened in a run, in the order of time. Each item shows its time. */
import { element } from "./controls.js";
import { withUnit } from "./format.js";
import { write } from "./view.js";

export class Happenings {
  /**
   * @param {HTMLElement} box
   * @param {(time: number) => void} pick a time that is chosen [s]
   */
  constructor(box, pick) {
    this.box = box;
    this.pick = pick;
    this.items = [];
  }

  /** @param {Array<{time: number, kind: string, words: string}>} list times [s], kinds as those of the verdict, or "" */
  show(list) {
    while (this.items.length < list.length) this.add();
    this.items.forEach(({ button, when, what }, i) => {
      button.hidden = i >= list.length;
      if (button.hidden) return;
      const { time, kind, words } = list[i];
      button.className = kind;
      write(when, withUnit(time, "s"));
      write(what, words);
    });
    this.list = list;
  }

  /** Items stay where they are from run to run, so that the one that has the focus keeps it. */
  add() {
    const place = this.items.length;
    const [when, what] = [element("b"), element("span")];
    const button = element("button", { type: "button", onclick: () => this.pick(this.list[place].time) }, when, " ", what);
    this.box.append(button);
    this.items.push({ button, when, what });
  }
}
