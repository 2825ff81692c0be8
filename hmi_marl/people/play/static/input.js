// Keys, buttons and strokes on the road, as the action of the next decision.

const KEYS = {
  ArrowLeft: 0, a: 0, ArrowRight: 2, d: 2, ArrowUp: 3, w: 3, ArrowDown: 4, s: 4,
};
const KEEP = 1;
const STROKE = 24; // shortest stroke [px]

export class Steering {
  constructor(canvas, buttons) {
    this.held = [];
    this.tapped = null;
    buttons.forEach((button) => {
      const action = Number(button.dataset.action);
      hold(button, () => this.press(action), () => this.release(action));
    });
    strokes(canvas, (action) => this.tap(action));
  }

  key(event, down) {
    const action = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (action === undefined) return false;
    if (!down) this.release(action);
    else if (!event.repeat) this.press(action);
    return true;
  }

  press(action) {
    this.tapped = action;
    if (!this.held.includes(action)) this.held.push(action);
  }

  tap(action) {
    this.tapped = action;
  }

  release(action) {
    this.held = this.held.filter((each) => each !== action);
  }

  forget() {
    this.held = [];
    this.tapped = null;
  }

  // The newest key of the last 1/5 s, else the newest that is held, else keep on.
  take() {
    const action = this.tapped ?? this.held[this.held.length - 1] ?? KEEP;
    this.tapped = null;
    return action;
  }
}

export class Alerting {
  constructor(buttons) {
    this.strengths = buttons.length;
    this.forget();
    buttons.forEach((button) => {
      const action = Number(button.dataset.action);
      hold(button, () => this.press(action), () => this.release());
    });
  }

  key(event, down) {
    const number = event.key === " " ? this.strengths : Number(event.key);
    if (!(number >= 1 && number <= this.strengths)) return false;
    if (!down) this.release();
    else if (!event.repeat) this.press(number);
    return true;
  }

  press(action) {
    this.tapped = this.now = action;
  }

  release() {
    this.now = 0;
  }

  forget() {
    this.tapped = this.now = 0;
  }

  take() {
    const action = this.tapped || this.now;
    this.tapped = 0;
    return action;
  }
}

// A button that acts as long as it is pressed, by mouse, touch or key.
function hold(button, press, release) {
  const down = () => { button.classList.add("held"); press(); };
  const up = () => { button.classList.remove("held"); release(); };
  button.addEventListener("pointerdown", (event) => { event.preventDefault(); button.setPointerCapture(event.pointerId); down(); });
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) button.addEventListener(name, up);
  button.addEventListener("contextmenu", (event) => event.preventDefault());
  button.addEventListener("click", (event) => { if (event.detail === 0) { press(); release(); } }); // by key or assistive technology
}

function strokes(canvas, tap) {
  let from = null;
  canvas.addEventListener("pointerdown", (event) => { from = [event.clientX, event.clientY]; });
  canvas.addEventListener("pointerup", (event) => {
    if (!from) return;
    const [x, y] = [event.clientX - from[0], event.clientY - from[1]];
    from = null;
    if (Math.max(Math.abs(x), Math.abs(y)) < STROKE) return;
    tap(Math.abs(x) > Math.abs(y) ? (x < 0 ? 0 : 2) : y < 0 ? 3 : 4);
  });
}
