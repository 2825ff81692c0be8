// A trip: connect, show what the server sends, and send a decision every 1/5 s.
import { Film } from "./film.js";
import { Alerting, Steering } from "./input.js";
import { Link, TAKEN_OVER } from "./link.js";
import { RoadView } from "./road.js";
import { Sound } from "./sound.js";
import { Task } from "./task.js";
import { t } from "./texts.js";

const SHOWN = 900; // time for which an alert is shown [ms]
const find = (id) => document.getElementById(id);
const driving = document.body.dataset.seat === "driver";
const view = new RoadView(find("road"));
const film = new Film();
const sound = new Sound(find("sound"), (on) => (on ? t("trip.sound.on") : t("trip.sound.off")));
const buttons = [...document.querySelectorAll("button[data-action]")];
const input = driving ? new Steering(find("road"), buttons) : new Alerting(buttons);
const stage = document.querySelector(".stage");
let state = null; // the newest from the server
let pace = 200; // time between decisions [ms]
let lanes = 0;
let going = false; // whether decisions are sent
let begun = false;
let connected = false;
let next = 0; // time of the next decision [ms]
let alertedUntil = 0;
let points = 0;

const link = new Link(document.body.dataset.trip, {
  hello(message) {
    connected = true;
    pace = 1000 * message.pace;
    lanes = message.road.lanes;
    view.setRoad(message.road);
    if (task) {
      task.show(message.puzzle);
      points = message.points;
      fact("points", points);
    }
  },
  state(message) {
    const first = state === null;
    const fresh = first || message.step > state.step;
    state = message;
    film.push(message.moments);
    if (fresh && !first && message.alert) announce(message);
    facts();
    if (message.over) return over();
    if (first || find("cover").dataset.why === "lost") ready();
    schedule();
    return undefined;
  },
  puzzle(message) {
    points = message.points;
    fact("points", points);
    say(message.right ? t("trip.task.right", { worth: message.worth }) : t("trip.task.wrong"));
    task.show(message);
  },
  lost(code) {
    connected = false;
    if (task) task.again();
    if (state && state.over) return;
    cover(code === 1013 ? t("trip.full") : t("trip.lost"), null, "lost");
  },
  closed(code) {
    connected = going = false;
    if (code !== TAKEN_OVER) return cover(t("trip.gone"), "on");
    cover(t("trip.elsewhere"), "start");
    find("start").textContent = t("trip.takeback");
    return undefined;
  },
});
const task = driving
  ? new Task(find("task"), find("task-button"), (puzzle, number) => link.found(puzzle, number), () => input.forget())
  : null;

function ready() {
  if (going) return uncover();
  const keys = driving ? t("trip.ready.driver") : t("trip.ready.vehicle_ai");
  cover(begun ? t("trip.paused") : keys, "start");
  find("start").textContent = state.step ? t("trip.goon") : t("trip.start");
  return undefined;
}

function start() {
  if (!link.socket && !connected) return window.location.reload();
  sound.wake();
  going = begun = true;
  input.forget();
  next = performance.now();
  uncover();
  schedule();
  return undefined;
}

function pause() {
  if (!going || (state && state.over)) return;
  going = false;
  ready();
}

function schedule() {
  if (!going || !connected || !state || state.over || link.waiting) return;
  clearTimeout(schedule.timer);
  schedule.timer = setTimeout(decide, Math.max(0, next - performance.now()));
}

function decide() {
  if (!going || !connected || state.over || link.waiting) return;
  const now = performance.now();
  next = Math.max(next + pace, now + pace / 2);
  const away = task && task.open;
  const action = input.take();
  link.decide(state.step, away ? 1 : action, driving ? Number(away) : null);
}

function announce(message) {
  const words = driving ? t("trip.alert.seen") : t("trip.alert.given");
  alertedUntil = performance.now() + SHOWN;
  find("banner").textContent = words;
  find("banner").hidden = false;
  stage.classList.toggle("alerted", driving);
  find("alert-text").textContent = "";
  find("alert-text").textContent = words;
  if (driving) sound.alert(message.strength);
}

function facts() {
  const lane = state.lane >= lanes ? t("trip.lane.ramp") : t("trip.lane.of", { lane: state.lane + 1, lanes });
  fact("lane", lane);
  fact("score", Math.round(state.score));
  fact("time", t("trip.unit.time", { seconds: Math.ceil(((state.steps - state.step) * pace) / 1000) }));
  if (driving) return;
  const eyes = state.distracted === null ? "unknown" : state.distracted ? "away" : "road";
  fact("eyes", t(`trip.eyes.${eyes}`));
  find("fact-eyes").className = eyes === "away" ? "alarm" : "";
  fact("intent", state.intended === null ? "–" : t(`trip.intent.${state.intended}`));
  fact("effect", t("trip.unit.time", { seconds: (((state.left ?? 0) * pace) / 1000).toFixed(1) }));
}

function fact(name, value) {
  const place = find(`fact-${name}`);
  if (place.textContent !== String(value)) place.textContent = String(value);
}

function over() {
  going = false;
  if (task) task.toggle(false);
  const score = Math.round(state.score);
  const words = [state.crashed ? t("trip.over.crashed", { score }) : t("trip.over.whole", { score })];
  if (points) words.push(t("trip.over.points", { points, total: score + points }));
  cover(words.join(" "), "on");
  find("on").focus({ preventScroll: true });
}

function cover(text, what, why = "") {
  find("message").textContent = text;
  find("start").hidden = what !== "start";
  find("on").hidden = what !== "on";
  find("cover").hidden = false;
  find("cover").dataset.why = why;
  if (what === "start") find("start").focus({ preventScroll: true });
}

function uncover() {
  find("cover").hidden = true;
  find("cover").dataset.why = "";
}

function say(text) {
  find("status").textContent = text;
}

function keyed(event, down) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const typing = ["INPUT", "SELECT", "TEXTAREA"].includes(event.target.tagName);
  if (typing || !going) return;
  if (task && down && !event.repeat && (event.key.toLowerCase() === "n" || (event.key === "Escape" && task.open))) {
    event.preventDefault();
    return void task.toggle();
  }
  if (task && task.open) {
    if (down && task.key(event)) event.preventDefault();
    return;
  }
  if (event.key === " " && event.target.tagName === "BUTTON" && !event.target.dataset.action) return;
  if (input.key(event, down)) event.preventDefault();
}

function frame(now) {
  if (film.moments.length) {
    const moment = film.advance(now / 1000);
    const alerted = now < alertedUntil;
    view.draw(moment, { alert: alerted, away: !driving && state.distracted === 1 });
    fact("speed", t("trip.unit.speed", { speed: Math.round(3.6 * moment.v[0]) }));
    if (!alerted && !find("banner").hidden) {
      find("banner").hidden = true;
      stage.classList.remove("alerted");
    }
  }
  requestAnimationFrame(frame);
}

find("start").addEventListener("click", start);
document.addEventListener("keydown", (event) => keyed(event, true));
document.addEventListener("keyup", (event) => keyed(event, false));
window.addEventListener("blur", () => input.forget());
document.addEventListener("visibilitychange", () => { if (document.hidden) pause(); });
requestAnimationFrame(frame);
