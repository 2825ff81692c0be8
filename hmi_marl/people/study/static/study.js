// Plays the clip unless the reader wants less motion, and sends answers until the server has
// acknowledged them. Pages work without this file too.

const FIRST_PAUSE = 1000;
const LONGEST_PAUSE = 10000;

const video = document.querySelector("video");
if (video) {
  const play = document.getElementById("play");
  const label = () => {
    const { play: first, pause, again } = play.dataset;
    play.textContent = video.ended ? again : video.paused ? first : pause;
  };
  for (const event of ["play", "pause", "ended"]) video.addEventListener(event, label);
  play.addEventListener("click", () => (video.paused ? video.play() : video.pause()));
  video.controls = false;
  video.muted = true;
  play.hidden = false;
  if (!matchMedia("(prefers-reduced-motion: reduce)").matches) video.play().catch(() => {});
}

const form = document.getElementById("answer");
const button = form.querySelector("button");
const status = form.querySelector("[role=status]");

form.addEventListener("submit", async (event) => {
  event.preventDefault();
  if (button.disabled) return;
  button.disabled = true;
  const body = new URLSearchParams(new FormData(form));
  for (let pause = FIRST_PAUSE; ; pause = Math.min(2 * pause, LONGEST_PAUSE)) {
    try {
      const headers = { Accept: "application/json" };
      const answer = await fetch(form.action, { method: "POST", body, headers });
      if (answer.ok) {
        location.replace(form.dataset.next);
        return;
      }
      if (answer.status < 500 && answer.status !== 429) {
        form.submit(); // the page of the error says what is wrong
        return;
      }
    } catch {
      // no connection; the answer stays here and is sent again
    }
    status.textContent = status.dataset.text;
    await new Promise((done) => setTimeout(done, pause));
  }
});
