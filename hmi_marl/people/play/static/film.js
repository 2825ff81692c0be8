// Vehicles between the moments that the server sent, which are 1/15 s apart.

const AHEAD = 0.1; // time that is kept in hand, so that a late state does not stop the picture [s]

export class Film {
  constructor() {
    this.moments = [];
    this.shown = 0; // time that is shown [s]
    this.before = null; // time of the last picture [s]
  }

  get end() {
    return this.moments.length ? this.moments[this.moments.length - 1].t : 0;
  }

  // Add moments; those that are known already are left out.
  push(moments) {
    const empty = this.moments.length === 0;
    for (const moment of moments) {
      if (this.moments.length === 0 || moment.t > this.end + 1e-6) this.moments.push(moment);
    }
    if (empty) this.shown = this.end;
    while (this.moments.length > 30) this.moments.shift();
  }

  // Go on by the time that has passed, a little slower or faster to keep some in hand.
  advance(now) {
    const passed = this.before === null ? 0 : Math.min(0.25, now - this.before);
    this.before = now;
    const hand = this.end - this.shown;
    const rate = hand > 0.45 ? 1.5 : hand > 0.3 ? 1.1 : hand < AHEAD ? 0.85 : 1;
    this.shown = Math.min(this.end, this.shown + passed * rate);
    return this.at(this.shown);
  }

  at(time) {
    return between(this.moments, time);
  }
}

// The vehicles at a time, interpolated between two moments.
export function between(moments, time) {
  let next = moments.findIndex((moment) => moment.t >= time);
  if (next < 0) next = moments.length - 1;
  if (next <= 0) return moments[Math.max(0, next)];
  const [one, two] = [moments[next - 1], moments[next]];
  const share = Math.min(1, Math.max(0, (time - one.t) / (two.t - one.t)));
  const mix = (name) => two[name].map((value, k) => one[name][k] + share * (value - one[name][k]));
  return { t: time, x: mix("x"), y: mix("y"), h: mix("h"), v: mix("v"), c: two.c };
}
