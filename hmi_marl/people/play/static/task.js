// The second task: a number to find among others. It covers the road while it is open.
import { t } from "./texts.js";

const COLUMNS = 4;

export class Task {
  // answer(puzzle, number) sends an answer; changed() is called when it opens or closes.
  constructor(root, button, answer, changed) {
    this.root = root;
    this.button = button;
    this.answer = answer;
    this.changed = changed;
    this.now = null;
    this.waiting = false;
    this.heading = document.createElement("h2");
    this.heading.id = "task-find";
    this.grid = document.createElement("div");
    this.grid.className = "grid";
    this.grid.setAttribute("role", "group");
    this.grid.setAttribute("aria-labelledby", "task-find");
    root.append(this.heading, this.grid);
    button.addEventListener("click", () => this.toggle());
  }

  get open() {
    return !this.root.hidden;
  }

  show(puzzle) {
    const place = Math.max(0, [...this.grid.children].indexOf(document.activeElement));
    this.now = puzzle;
    this.waiting = false;
    this.heading.textContent = t("trip.task.find", { number: puzzle.target });
    this.grid.replaceChildren(...puzzle.numbers.map((number, k) => {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = String(number);
      button.tabIndex = k === place ? 0 : -1;
      button.addEventListener("click", () => this.pick(number));
      return button;
    }));
    if (this.open) this.grid.children[place].focus({ preventScroll: true });
  }

  pick(number) {
    if (this.waiting || !this.now) return;
    this.waiting = true;
    this.answer(this.now.puzzle, number);
  }

  // After a lost connection an answer may have to be given again.
  again() {
    this.waiting = false;
  }

  toggle(open = !this.open) {
    if (open === this.open || (open && !this.now)) return;
    this.root.hidden = !open;
    this.button.setAttribute("aria-expanded", String(open));
    this.button.textContent = open ? t("trip.task.close") : t("trip.task.open");
    if (open) this.grid.children[0].focus({ preventScroll: true });
    else this.button.focus({ preventScroll: true });
    this.changed();
  }

  // Arrows go from number to number while it is open.
  key(event) {
    const step = { ArrowLeft: -1, ArrowRight: 1, ArrowUp: -COLUMNS, ArrowDown: COLUMNS }[event.key];
    if (step === undefined) return false;
    const all = [...this.grid.children];
    const place = all.indexOf(document.activeElement);
    const next = all[Math.min(all.length - 1, Math.max(0, place + step))] || all[0];
    all.forEach((each) => { each.tabIndex = each === next ? 0 : -1; });
    next.focus({ preventScroll: true });
    return true;
  }
}
