// The alert as two short tones.

const KEPT = "hmi-marl-sound";

export class Sound {
  constructor(button, words) {
    this.on = read() !== "off";
    this.button = button;
    this.words = words;
    this.show();
    button.addEventListener("click", () => {
      this.on = !this.on;
      keep(this.on ? "on" : "off");
      this.show();
      if (this.on) this.wake();
    });
  }

  show() {
    this.button.textContent = this.words(this.on);
    this.button.setAttribute("aria-pressed", String(this.on));
  }

  // Browsers let a page sound only after a click or a key.
  wake() {
    if (!this.on) return;
    this.context ??= new AudioContext();
    this.context.resume();
  }

  alert(strength = 1) {
    if (!this.on || !this.context) return;
    const now = this.context.currentTime;
    [880, 1175].forEach((pitch, k) => {
      const tone = this.context.createOscillator();
      const level = this.context.createGain();
      tone.frequency.value = pitch;
      level.gain.setValueAtTime(0.0001, now + 0.13 * k);
      level.gain.exponentialRampToValueAtTime(0.05 + 0.15 * strength, now + 0.13 * k + 0.02);
      level.gain.exponentialRampToValueAtTime(0.0001, now + 0.13 * k + 0.12);
      tone.connect(level).connect(this.context.destination);
      tone.start(now + 0.13 * k);
      tone.stop(now + 0.13 * k + 0.13);
    });
  }
}

function read() {
  try { return localStorage.getItem(KEPT); } catch { return null; }
}

function keep(value) {
  try { localStorage.setItem(KEPT, value); } catch { /* it is not kept then */ }
}
