// Lists and tables that are kept in step with the robot: elements stay, their texts change, so nothing loses the focus.

function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

function make(tag, className, text = "") {
  const element = document.createElement(tag);
  if (className) element.className = className;
  element.textContent = text;
  return element;
}

/** One child for each item, found again by its key; `fresh` makes a child, `update` fills it. */
function keep(parent, items, keyOf, fresh, update) {
  const known = new Map([...parent.children].map((child) => [child.dataset.key, child]));
  items.forEach((item, place) => {
    const key = keyOf(item);
    let child = known.get(key);
    if (!child) {
      child = fresh(item);
      child.dataset.key = key;
    }
    known.delete(key);
    if (parent.children[place] !== child) parent.insertBefore(child, parent.children[place] ?? null);
    update(child, item);
  });
  for (const child of known.values()) child.remove();
}

export function age(seconds) {
  if (seconds === null) return "never";
  if (seconds < 10) return `${seconds.toFixed(2)} s`;
  return seconds < 1000 ? `${seconds.toFixed(0)} s` : `${(seconds / 60).toFixed(0)} min`;
}

// ----------------------------------------------------------------------------------------- behaviours

/** act("start" | "cancel", name) is called when its button is pressed. */
export function showBehaviours(list, status, drawings, colourOf, act) {
  const fresh = (behaviour) => {
    const row = make("li");
    const name = make("span", "name");
    name.append(make("i", "swatch"), make("span", "", behaviour.name), " ", make("span", "state"));
    const button = make("button");
    button.type = "button";
    button.addEventListener("click", () => act(button.dataset.act, behaviour.name));
    row.append(name, button, make("p", "why"), make("p", "says"));
    return row;
  };
  keep(list, status.behaviours, (b) => b.name, fresh, (row, b) => {
    row.classList.toggle("drives", b.active && b.name === status.by);
    row.querySelector(".swatch").style.background = drawings[b.name] ? colourOf(b.name) : "transparent";
    setText(row.querySelector(".state"), b.state || (b.active ? "active" : "inactive"));
    const button = row.querySelector("button");
    button.dataset.act = b.active ? "cancel" : "start";
    setText(button, b.active ? "Cancel" : "Start");
    button.setAttribute("aria-label", `${b.active ? "Cancel" : "Start"} ${b.name}`);
    const why = b.active ? b.verdict_reason : "";
    setText(row.querySelector(".why"), `priority ${b.priority}${why ? `, ${why}` : ""}`);
    setText(row.querySelector(".says"), said(b.active ? drawings[b.name] : null));
  });
}

/** The texts and numbers of an explanation in one line; its state is shown already. */
function said(items) {
  return (items ?? [])
    .filter((item) => item.type === "Scalar" || (item.type === "Text" && item.name !== "state"))
    .map((item) => (item.type === "Text" ? `${item.name} ${item.text}` : `${item.name} ${number(item.value, item.unit)}`))
    .join(" · ");
}

function number(value, unit) {
  if (value === null) return "–";
  return `${Math.abs(value) >= 100 ? value.toFixed(0) : value.toFixed(2)}${unit ? ` ${unit}` : ""}`;
}

// -------------------------------------------------------------------------------------------- command

export function showCommand(list, status, hello) {
  const limits = hello?.limits ?? { vx_mps: 0.5, vy_mps: 0, wz_radps: 2 };
  const command = status.command;
  const rows =
    "speed_mps" in command
      ? [["speed", command.speed_mps, "m/s", limits.vx_mps], ["steering", command.steering_rad, "rad", 0.5]]
      : [["forward", command.vx_mps, "m/s", limits.vx_mps], ["turn", command.wz_radps, "rad/s", limits.wz_radps]];
  if (command.vy_mps || limits.vy_mps) rows.splice(1, 0, ["left", command.vy_mps, "m/s", limits.vy_mps || 0.5]);
  const parts = rows.flatMap(([name, value, unit, full]) => [
    { key: `${name} name`, tag: "dt", text: name },
    { key: `${name} value`, tag: "dd", text: `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(2)} ${unit}` },
    { key: `${name} bar`, tag: "dd", share: Math.max(-1, Math.min(1, value / full)), turns: name !== "forward" },
  ]);
  const fresh = (part) => {
    const element = make(part.tag);
    if (part.share !== undefined) {
      element.className = "bar";
      element.setAttribute("aria-hidden", "true");
      element.append(make("i"));
    }
    return element;
  };
  keep(list, parts, (part) => part.key, fresh, (element, part) => {
    if (part.text !== undefined) return setText(element, part.text);
    // what turns or goes left is positive, and left is drawn left
    const share = part.turns && part.key !== "speed bar" ? -part.share : part.share;
    element.firstChild.style.left = `${50 + 50 * Math.min(0, share)}%`;
    element.firstChild.style.width = `${50 * Math.abs(share)}%`;
    return undefined;
  });
}

// -------------------------------------------------------------------------------- streams and devices

export function showStreams(table, streams) {
  const fresh = () => {
    const row = make("tr");
    row.append(make("td"), make("td"), make("td", "number"), make("td", "number"), make("td", "number"));
    return row;
  };
  keep(table, streams, (s) => s.topic, fresh, (row, s) => {
    const [topic, source, rate, howOld, faults] = row.children;
    setText(topic, s.topic);
    setText(source, s.source);
    setText(rate, `${s.rate_hz.toFixed(1)} Hz`);
    setText(howOld, age(s.age_s));
    setText(faults, String(s.faults));
    howOld.classList.toggle("bad", s.age_s === null || s.age_s > 1.0);
    faults.classList.toggle("bad", s.faults > 0);
  });
}

export function showDevices(list, devices) {
  keep(list, devices, (d) => d.name, () => make("li"), (item, d) => {
    const open = d.state === "open";
    item.classList.toggle("bad", !open || d.detail !== "");
    setText(item, open && !d.detail ? d.name : `${d.name} ${d.state}${d.detail ? `: ${d.detail}` : ""}`);
  });
}

// --------------------------------------------------------------------------------------------- events

const EVENTS_SHOWN = 100;

export function showEvents(list, empty, entries, status) {
  for (const entry of entries) {
    const row = make("li", entry.kind);
    row.append(make("time", "", instant(entry.stamp_ns, status)), make("span", "", entry.text));
    list.prepend(row);
  }
  while (list.children.length > EVENTS_SHOWN) list.lastChild.remove();
  empty.hidden = list.children.length > 0;
}

/** Time of day on a robot; on a simulated one its own seconds, because its day is not ours. */
function instant(stampNs, status) {
  if (status === null || status.virtual) return `${(stampNs / 1e9).toFixed(1)} s`;
  return new Date(Date.now() - (status.now_ns - stampNs) / 1e6).toLocaleTimeString();
}
