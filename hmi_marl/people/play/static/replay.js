// A trip again, from all its moments.
import { between } from "./film.js";
import { RoadView } from "./road.js";
import { t } from "./texts.js";

const find = (id) => document.getElementById(id);
const view = new RoadView(find("road"));
const place = find("place");
const button = find("play");
let film = null;
let time = 0;
let before = null;
let playing = false;

function show() {
  const moment = between(film.moments, time);
  const step = film.steps_taken[Math.min(film.steps_taken.length - 1, Math.floor(time / film.pace))];
  view.draw(moment, { alert: step && step.alert > 0, away: step && step.away === 1 });
  const alerted = Boolean(step && step.alert > 0);
  find("banner").hidden = !alerted;
  find("banner").textContent = alerted ? t("trip.alert.seen") : "";
  place.value = String(time);
  const words = t("trip.replay.time", { seconds: time.toFixed(1), speed: Math.round(3.6 * moment.v[0]) });
  place.setAttribute("aria-valuetext", words);
  if (!playing) find("status").textContent = words;
}

function frame(now) {
  if (playing) {
    time = Math.min(film.end, time + (before === null ? 0 : (now - before) / 1000));
    if (time >= film.end) play(false);
    show();
  }
  before = now;
  requestAnimationFrame(frame);
}

function play(on) {
  playing = on;
  if (on && time >= film.end) time = 0;
  button.textContent = on ? t("trip.replay.pause") : t("trip.replay.play");
}

button.addEventListener("click", () => film && play(!playing));
place.addEventListener("input", () => {
  if (!film) return;
  play(false);
  time = Number(place.value);
  show();
});
try {
  const answer = await fetch(document.body.dataset.film);
  if (!answer.ok) throw new Error(answer.statusText);
  film = await answer.json();
  film.end = film.moments[film.moments.length - 1].t;
  view.setRoad(film.road);
  place.max = String(film.end);
  place.step = "0.1";
  show();
  requestAnimationFrame(frame);
  button.disabled = false;
} catch {
  find("status").textContent = t("trip.replay.failed");
}
