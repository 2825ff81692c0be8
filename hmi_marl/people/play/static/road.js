// The road from above, the driven car low in the middle and heading up.

const VISIBLE = 62; // length of road that is seen [m]
const BEHIND = 14; // of it behind the driven car [m]
const calm = window.matchMedia("(prefers-reduced-motion: reduce)");
const dark = window.matchMedia("(prefers-color-scheme: dark)");
const NAMES = ["grass", "grass-line", "road", "road-line", "car", "car-other", "car-edge", "car-crashed", "ring"];

export class RoadView {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.road = null;
    this.last = null;
    this.fit();
    this.readColours();
    dark.addEventListener("change", () => { this.readColours(); this.again(); });
    new ResizeObserver(() => { this.fit(); this.again(); }).observe(canvas);
  }

  setRoad(road) {
    this.road = road;
    const ramp = road.ramp;
    const beside = road.lanes * road.width;
    const merging = ramp.find(([, y]) => Math.abs(y - beside) < 0.05) || ramp[ramp.length - 1];
    this.merging = [merging[0], ramp[ramp.length - 1][0]];
    this.middle = (beside + road.width) / 2;
  }

  readColours() {
    const style = getComputedStyle(document.documentElement);
    this.colours = Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  }

  fit() {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    this.width = this.canvas.clientWidth;
    this.height = this.canvas.clientHeight;
    this.canvas.width = Math.round(this.width * ratio);
    this.canvas.height = Math.round(this.height * ratio);
    this.ratio = ratio;
  }

  again() {
    if (this.last) this.draw(...this.last);
  }

  // Draw a moment; marks: {alert: whether one was given just now, away: whether the driver is distracted}.
  draw(moment, marks = {}) {
    if (!this.road || !moment) return;
    this.last = [moment, marks];
    const { context, colours, ratio } = this;
    const scale = Math.min(this.height / VISIBLE, this.width / 24);
    const here = moment.x[0];
    const [low, high] = [here - this.height / scale, here + this.height / scale];
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.fillStyle = colours.grass;
    context.fillRect(0, 0, this.canvas.width, this.canvas.height);
    // Metres: x along the road is up, y across it grows to the right.
    const px = scale * ratio;
    const across = (this.width / 2 - this.middle * scale) * ratio;
    const along = (this.height - BEHIND * scale) * ratio + here * px;
    context.setTransform(0, -px, px, 0, across, along);
    this.drawGrass(low, high, this.width / scale);
    this.drawRoad(low, high);
    for (let k = moment.x.length - 1; k >= 0; k -= 1) {
      if (moment.x[k] > low && moment.x[k] < high) this.drawCar(moment, k, marks);
    }
  }

  drawGrass(low, high, width) {
    if (calm.matches) return;
    const { context, colours } = this;
    context.fillStyle = colours["grass-line"];
    for (let place = Math.floor(low / 9); place * 9 < high; place += 1) {
      for (const side of [-1, 1]) {
        const chance = hash(place * 2 + side);
        const away = 13 + chance * width * 0.5;
        context.beginPath();
        context.arc(place * 9 + 6 * hash(place * 7 + side), this.middle + side * away, 1 + 1.4 * hash(place + 31 * side), 0, 7);
        context.fill();
      }
    }
  }

  drawRoad(low, high) {
    const { context, colours, road } = this;
    const [left, right] = [-road.width / 2, (road.lanes - 0.5) * road.width];
    context.fillStyle = context.strokeStyle = colours.road;
    context.lineJoin = "round";
    context.lineWidth = road.width;
    path(context, road.ramp);
    context.fillRect(low, left - 0.4, high - low, right - left + 0.8);
    context.strokeStyle = colours["road-line"];
    context.lineWidth = 0.18;
    line(context, low, high, left);
    for (let lane = 1; lane < road.lanes; lane += 1) dashes(context, low, high, left + lane * road.width);
    const [begins, ends] = this.merging;
    line(context, low, Math.min(high, begins), right);
    line(context, Math.max(low, ends), high, right);
    dashes(context, Math.max(low, begins), Math.min(high, ends), right);
    const edge = road.ramp.map(([x, y]) => [x, y + road.width / 2]);
    path(context, edge);
    if (ends > low && ends < high) path(context, [[ends, right], [ends, right + road.width]]);
  }

  drawCar(moment, k, marks) {
    const { context, colours, road } = this;
    const [length, width] = road.car;
    const own = k === 0;
    context.save();
    context.translate(moment.x[k], moment.y[k]);
    context.rotate(moment.h[k]);
    if (own && marks.alert) {
      for (const [colour, thick] of [["car-edge", 0.9], ["ring", 0.5]]) { // seen on grass and on road
        context.strokeStyle = colours[colour];
        context.lineWidth = thick;
        context.beginPath();
        context.arc(0, 0, 4.6, 0, 7);
        context.stroke();
      }
    }
    context.fillStyle = moment.c[k] ? colours["car-crashed"] : own ? colours.car : colours["car-other"];
    context.strokeStyle = colours["car-edge"];
    context.lineWidth = 0.14;
    context.beginPath();
    context.roundRect(-length / 2, -width / 2, length, width, 0.6);
    context.fill();
    context.stroke();
    context.fillStyle = colours["car-edge"];
    context.globalAlpha = 0.75;
    context.beginPath(); // windscreen and rear window
    context.roundRect(0.35, -width / 2 + 0.28, 0.95, width - 0.56, 0.25);
    context.roundRect(-1.9, -width / 2 + 0.32, 0.6, width - 0.64, 0.2);
    context.fill();
    context.globalAlpha = 1;
    if (own && marks.away) {
      context.fillStyle = colours.ring;
      context.beginPath();
      context.arc(-0.55, 0, 0.65, 0, 7);
      context.fill();
    }
    context.restore();
  }
}

function path(context, points) {
  context.beginPath();
  points.forEach(([x, y], k) => (k ? context.lineTo(x, y) : context.moveTo(x, y)));
  context.stroke();
}

function line(context, from, to, y) {
  if (to > from) path(context, [[from, y], [to, y]]);
}

function dashes(context, from, to, y) {
  if (to <= from) return;
  context.setLineDash([3, 6]);
  context.lineDashOffset = from;
  line(context, from, to, y);
  context.setLineDash([]);
}

function hash(number) {
  const value = Math.sin(number * 127.1 + 311.7) * 43758.5453;
  return value - Math.floor(value);
}
