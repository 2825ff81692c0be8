// The connection of a trip: it comes back by itself, and no decision is lost or taken twice.
//
// A decision has the number of its step. It is sent again, as it was, until a state with a higher
// step acknowledges it.

const AGAIN = 1000; // time after which a decision is sent again [ms]
const WAITS = [200, 400, 800, 1500, 3000]; // before connecting again [ms]
export const TAKEN_OVER = 4001;
const FINAL = [TAKEN_OVER, 4003, 4004, 1008];

export class Link {
  // on: {hello, state, puzzle, lost(code), closed(code)}
  constructor(trip, on) {
    const base = document.body.dataset.base;
    const address = new URL(`${base}/trip/socket?trip=${trip}`, window.location.href);
    address.protocol = address.protocol.replace("http", "ws");
    this.address = address.href;
    this.on = on;
    this.pending = null;
    this.failures = 0;
    this.open();
  }

  open() {
    const socket = new WebSocket(this.address);
    this.socket = socket;
    socket.onmessage = (event) => this.receive(JSON.parse(event.data));
    socket.onclose = (event) => {
      if (this.socket !== socket) return;
      this.socket = null;
      if (FINAL.includes(event.code)) return this.on.closed(event.code);
      this.on.lost(event.code);
      const wait = WAITS[Math.min(this.failures, WAITS.length - 1)];
      this.failures += 1;
      setTimeout(() => this.open(), wait);
    };
  }

  receive(message) {
    if (message.type === "state") {
      if (this.pending && message.step > this.pending.step) this.clear();
      this.on.state(message);
    } else if (message.type === "hello") {
      this.failures = 0;
      this.on.hello(message);
      if (this.pending) this.transmit();
    } else if (message.type === "puzzle") {
      this.on.puzzle(message);
    }
  }

  get waiting() {
    return this.pending !== null;
  }

  decide(step, action, away) {
    this.pending = { type: "decide", step, action, away };
    this.transmit();
  }

  found(puzzle, number) {
    this.send({ type: "found", puzzle, number });
  }

  transmit() {
    clearTimeout(this.timer);
    this.send(this.pending);
    this.timer = setTimeout(() => this.pending && this.transmit(), AGAIN);
  }

  clear() {
    clearTimeout(this.timer);
    this.pending = null;
  }

  send(content) {
    if (this.socket && this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(content));
  }
}
