// The connection to the robot: opens, opens again, and knows when it has gone quiet.

const PING_MS = 500;
const QUIET_MS = 1500;
const RETRY_MS = 1000;
const OPENING_MS = 4000;

export class Link {
  /** handlers: onMessage(object), onScan(scan), onPicture(picture), onBeat(n), onState("opening" | "live" | "lost") */
  constructor(handlers) {
    this.handlers = handlers;
    this.state = "opening";
    this.heardMs = performance.now();
    this.roundTripMs = null;
    this.asks = new Map();
    this.nextId = 1;
    this.stopPending = false;
    this.open();
    setInterval(() => this.watch(), PING_MS);
  }

  open() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const wire = new WebSocket(`${scheme}://${location.host}/live`);
    wire.binaryType = "arraybuffer";
    this.wire = wire;
    this.openedMs = performance.now();
    wire.onopen = () => {
      if (this.stopPending) this.send({ do: "estop", id: this.nextId++ });
    };
    wire.onmessage = (event) => {
      if (wire !== this.wire) return;
      this.heard();
      if (typeof event.data === "string") this.text(JSON.parse(event.data));
      else this.binary(event.data);
    };
    wire.onclose = () => {
      if (wire !== this.wire) return;
      this.setState("lost");
      for (const answered of this.asks.values()) answered({ ok: false, reason: "the connection is lost" });
      this.asks.clear();
      setTimeout(() => this.open(), RETRY_MS);
    };
  }

  /** Every half second: ask whether the robot is there; one that does not answer is not shown as live. */
  watch() {
    const quietMs = performance.now() - this.heardMs;
    if (this.wire.readyState === WebSocket.OPEN) {
      this.pingMs = performance.now();
      this.send({ do: "ping", id: this.nextId++ });
    }
    if (quietMs > QUIET_MS) this.setState("lost");
    const stuck = this.wire.readyState === WebSocket.CONNECTING && performance.now() - this.openedMs > OPENING_MS;
    if (stuck) this.wire.close();
  }

  heard() {
    this.heardMs = performance.now();
  }

  setState(state) {
    if (state === this.state) return;
    this.state = state;
    this.handlers.onState(state);
  }

  send(message) {
    if (this.wire.readyState === WebSocket.OPEN) this.wire.send(JSON.stringify(message));
  }

  /** Ask something of the robot; resolves to {ok, reason}. */
  ask(message) {
    if (this.wire.readyState !== WebSocket.OPEN) {
      return Promise.resolve({ ok: false, reason: "there is no connection to the robot" });
    }
    const id = this.nextId++;
    return new Promise((resolve) => {
      this.asks.set(id, resolve);
      this.send({ ...message, id });
    });
  }

  /** The e-stop. Without a connection it is the first thing that the robot hears once there is one. */
  stop() {
    this.stopPending = true;
    return this.ask({ do: "estop" });
  }

  text(message) {
    if (message.kind === "pong") {
      this.roundTripMs = performance.now() - this.pingMs;
      return;
    }
    if (message.kind === "answer") {
      if (message.do === "estop" && message.ok) this.stopPending = false;
      this.asks.get(message.id)?.(message);
      this.asks.delete(message.id);
      return;
    }
    if (message.kind === "beat") {
      this.handlers.onBeat(message.n);
      return;
    }
    // only a status makes the page live: an open socket alone says nothing about the robot
    if (message.kind === "status") this.setState("live");
    this.handlers.onMessage(message);
  }

  binary(buffer) {
    const view = new DataView(buffer);
    const head = { index: view.getUint8(1), stampS: view.getFloat64(8, true) };
    if (view.getUint8(0) === 1) {
      const count = view.getUint32(4, true);
      const f32 = (offset) => view.getFloat32(offset, true);
      this.handlers.onScan({
        ...head,
        x: f32(16),
        y: f32(20),
        yaw: f32(24),
        rangeMin: f32(28),
        rangeMax: f32(32),
        angles: new Float32Array(buffer, 36, count),
        ranges: new Float32Array(buffer, 36 + 4 * count, count),
      });
    } else if (view.getUint8(0) === 2) {
      const jpeg = new Blob([new Uint8Array(buffer, 16)], { type: "image/jpeg" });
      this.handlers.onPicture({ ...head, width: view.getUint16(2, true), height: view.getUint32(4, true), jpeg });
    }
  }
}
