// Ties the page together: what the robot says goes into the document, what people press goes to the robot.

import { Link } from "./link.js";
import { Scene, drawCamera, readColours, shade } from "./scene.js";
import { showBehaviours, showCommand, showDevices, showEvents, showStreams } from "./tables.js";

const PROTOCOL = 1;
const OLD_S = 1.0;
const SAID_MS = 6000;

const $ = (id) => document.getElementById(id);
const body = document.body;

const seen = {
  hello: null,
  status: null,
  statusMs: 0,
  scans: [],
  picture: null,
  decoding: Promise.resolve(),
  drawings: {},
};

const scene = new Scene($("scan"));

const link = new Link({
  onMessage(message) {
    if (message.kind === "hello") greet(message);
    else if (message.kind === "status") showStatus(message);
    else if (message.kind === "drawings") seen.drawings = message.by;
    else if (message.kind === "events") showEvents($("events"), $("no-events"), message.entries, seen.status);
  },
  onScan(scan) {
    seen.scans[scan.index] = scan;
  },
  onPicture(picture) {
    seen.decoding = createImageBitmap(picture.jpeg).then(
      (bitmap) => {
        seen.picture?.bitmap.close();
        seen.picture = { ...picture, bitmap };
      },
      () => {},
    );
  },
  // what was drawn is answered; the robot sends no more before that, so a slow page sees less, not late
  async onBeat(n) {
    await seen.decoding;
    requestAnimationFrame(() => {
      draw();
      link.send({ do: "beat", n });
    });
  },
  onState: showLink,
});

// --------------------------------------------------------------------------------- from the robot

function greet(hello) {
  if (hello.protocol !== PROTOCOL) {
    say("robotd was updated: reload this page");
    return;
  }
  const again = seen.hello !== null;
  Object.assign(seen, { hello, scans: [], drawings: {} });
  $("robot").textContent = hello.robot;
  document.title = `${hello.robot} · robotd`;
  $("camera-section").hidden = hello.cameras.length === 0;
  const pick = $("camera-pick");
  const chosen = again ? pick.value : hello.cameras[0];
  pick.replaceChildren(...hello.cameras.map((name) => new Option(name, name)), new Option("off", ""));
  pick.value = hello.cameras.includes(chosen) ? chosen : "";
  if (again) look();
  $("events").replaceChildren();
}

function showStatus(status) {
  seen.status = status;
  seen.statusMs = performance.now();
  body.dataset.mode = status.mode;
  setText($("mode"), status.mode === "estop" ? "e-stop" : status.mode);
  setText($("sentence"), status.sentence);
  $("virtual").hidden = !status.virtual;

  const stopped = status.mode === "estop";
  const armed = !stopped && status.mode !== "disarmed";
  setText($("estop-word"), stopped ? "E-STOPPED" : "E-STOP");
  setText($("estop-hint"), stopped ? "latched" : "space bar");
  $("estop").setAttribute("aria-pressed", String(stopped));
  $("reset").hidden = !stopped;
  $("arm").hidden = armed || stopped;
  $("disarm").hidden = !armed;
  $("pause").hidden = !armed || status.mode === "paused";
  $("resume").hidden = !(status.mode === "paused" || status.mode === "manual");

  const names = Object.keys(seen.drawings);
  showBehaviours($("behaviours"), status, seen.drawings, (name) => shade(names.indexOf(name)), (what, name) => {
    ask({ do: what, behaviour: name });
  });
  $("no-behaviours").hidden = status.behaviours.length > 0;
  showCommand($("command"), status, seen.hello);
  showStreams($("streams"), status.streams);
  showDevices($("devices"), status.devices);
}

function showLink(state) {
  body.dataset.link = state;
  tick();
}

/** What depends on time alone: how old the page's knowledge is. */
function tick() {
  const live = link.state === "live";
  const quietS = (performance.now() - link.heardMs) / 1000;
  $("lost").hidden = live || (link.state === "opening" && quietS < 1);
  if (!live) {
    const since = seen.status ? `what you see is ${quietS.toFixed(0)} s old` : "nothing was heard from it yet";
    const stop = link.stopPending ? " E-STOP WAITS: it is sent as soon as the robot is reached." : "";
    setText($("lost"), `No connection to the robot: ${since}. The robot may be moving.${stop}`);
    if (seen.status) {
      setText($("mode"), "unknown");
      setText($("sentence"), "not known, the connection is lost");
    }
    setText($("link"), "not connected");
  } else {
    const lag = link.roundTripMs === null ? "" : `, there and back in ${link.roundTripMs.toFixed(0)} ms`;
    setText($("link"), `connected as page ${seen.hello?.viewer ?? ""}${lag}`);
  }
  for (const button of $("acts").children) button.disabled = !live;
}

function draw() {
  if (!seen.hello) return;
  // what a behaviour drew last is no longer meant once it has ended
  const ended = new Set(seen.status?.behaviours.filter((b) => !b.active).map((b) => b.name));
  const drawings = Object.entries(seen.drawings)
    .map(([name, items], index) => ({ name, index, items }))
    .filter(({ name }) => !ended.has(name));
  scene.draw(seen.scans, seen.hello.footprint_m, drawings);
  note($("scan-note"), seen.hello.scans[0], seen.scans.some(Boolean), "no lidar");
  const camera = $("camera-pick").value;
  const index = seen.hello.cameras.indexOf(camera);
  const picture = seen.picture && seen.picture.index === index ? seen.picture : null;
  drawCamera($("camera"), picture, drawings, camera);
  note($("camera-note"), camera, picture !== null, "off");
}

/** Says beside a view how fresh it is, and says it loudly once it is not. */
function note(element, topic, isThere, without) {
  const stream = seen.status?.streams.find((s) => s.topic === topic);
  const old = stream ? stream.age_s === null || stream.age_s > OLD_S : false;
  element.classList.toggle("bad", old);
  if (!stream) setText(element, topic ? "" : without);
  else if (stream.age_s === null) setText(element, isThere ? "LOST, this is the last one" : "nothing yet");
  else if (old) setText(element, `OLD: ${stream.age_s.toFixed(1)} s`);
  else setText(element, `${stream.rate_hz.toFixed(0)} Hz`);
}

// ----------------------------------------------------------------------------------- from people

let saidTimer = 0;
function say(text) {
  setText($("said"), text);
  $("said").hidden = false;
  clearTimeout(saidTimer);
  saidTimer = setTimeout(() => ($("said").hidden = true), SAID_MS);
}

async function ask(message) {
  const answer = await link.ask(message);
  if (!answer.ok) say(`${message.do.replace("_", " ")} refused: ${answer.reason}`);
}

async function stop() {
  const answer = await link.stop();
  if (!answer.ok) say(`E-STOP NOT DELIVERED: ${answer.reason}. Use the switch on the robot.`);
}

function look() {
  link.send({ do: "look", camera: $("camera-pick").value || null });
}

$("estop").addEventListener("pointerdown", (event) => {
  if (event.button === 0) stop(); // when the finger comes down, not when it leaves
});
$("estop").addEventListener("click", (event) => {
  if (event.detail === 0) stop(); // by the Enter key
});
for (const button of document.querySelectorAll("[data-do]")) {
  button.addEventListener("click", () => ask({ do: button.dataset.do }));
}
$("camera-pick").addEventListener("change", look);
$("reach-pick").addEventListener("change", (event) => {
  scene.chosen = Number(event.target.value) || null;
  draw();
});

// the space bar is the e-stop wherever the focus is, and so never presses a button
for (const kind of ["keydown", "keyup"]) {
  window.addEventListener(
    kind,
    (event) => {
      if (event.code !== "Space") return;
      event.preventDefault();
      event.stopPropagation();
      if (kind === "keydown" && !event.repeat) stop();
    },
    { capture: true },
  );
}

/** Text that changes only when it does, so that screen readers are not told the same twice. */
function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

readColours();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  readColours();
  draw();
});
window.addEventListener("resize", draw);
setInterval(tick, 250);
