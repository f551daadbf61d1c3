// Draws on the two canvases: the scan from above with what the plugins explain, and the camera with its overlays.

const VIEWS_M = [1, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10, 12, 16, 20, 30, 40];
const SHADES = 4;

let colours = {};
export function readColours() {
  const style = getComputedStyle(document.documentElement);
  const get = (name) => style.getPropertyValue(`--${name}`).trim();
  colours = Object.fromEntries(["card", "edge", "text", "soft", "scan", "rings", "body", "bad"].map((n) => [n, get(n)]));
  colours.draw = Array.from({ length: SHADES }, (_, i) => get(`draw-${i + 1}`));
}

/** The colour of a plugin's drawings, by its place among the plugins. */
export function shade(index) {
  return colours.draw[index % SHADES];
}

/** Fits the canvas to the screen's pixels; returns its context in CSS pixels, cleared. */
function prepared(canvas) {
  const scale = window.devicePixelRatio || 1;
  const { clientWidth: width, clientHeight: height } = canvas;
  const [w, h] = [Math.round(width * scale), Math.round(height * scale)];
  if (canvas.width !== w || canvas.height !== h) {
    canvas.width = w;
    canvas.height = h;
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(scale, 0, 0, scale, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.lineJoin = pen.lineCap = "round";
  pen.font = "12px system-ui, sans-serif";
  return { pen, width, height };
}

/** Text that stays readable over lines and pictures. */
function label(pen, text, x, y, colour, back) {
  pen.lineWidth = 3;
  pen.strokeStyle = back;
  pen.strokeText(text, x, y);
  pen.fillStyle = colour;
  pen.fillText(text, x, y);
}

// ------------------------------------------------------------------------------------------ from above

export class Scene {
  constructor(canvas) {
    this.canvas = canvas;
    this.reach = 2;
    this.chosen = null; // metres from the middle to the edge, null: as the scan needs
  }

  /** scans: by index; footprint: corners in base; drawings: [{name, index, items}] */
  draw(scans, footprint, drawings) {
    const { pen, width, height } = prepared(this.canvas);
    if (!width) return;
    this.chooseReach(scans, footprint);
    const scale = Math.min(width, height) / 2 / this.reach;
    const [cx, cy] = [width / 2, height / 2];
    // base: x forward is up, y left is left
    const at = ([x, y]) => [cx - y * scale, cy - x * scale];
    this.rings(pen, cx, cy, scale, Math.hypot(width, height) / 2);
    for (const scan of scans) if (scan) this.scan(pen, scan, cx, cy, scale);
    this.footprint(pen, footprint, at, scale);
    for (const { index, items } of drawings) for (const item of items) this.item(pen, item, shade(index), at, scale);
  }

  /** The smallest view that holds nine tenths of the returns; it shrinks only when clearly too large. */
  chooseReach(scans, footprint) {
    if (this.chosen) {
      this.reach = this.chosen;
      return;
    }
    const all = [];
    for (const scan of scans) if (scan) for (const range of scan.ranges) if (Number.isFinite(range)) all.push(range);
    if (!all.length) return;
    all.sort((a, b) => a - b);
    const body = Math.max(...footprint.map(([x, y]) => Math.hypot(x, y)));
    const wanted = Math.max(1.1 * all[Math.floor(0.9 * (all.length - 1))], 3 * body);
    const fitting = VIEWS_M.find((view) => view >= wanted) ?? VIEWS_M.at(-1);
    if (fitting > this.reach || wanted < 0.6 * this.reach) this.reach = fitting;
  }

  rings(pen, cx, cy, scale, far) {
    const step = this.reach <= 0.5 ? 0.1 : this.reach <= 1.5 ? 0.25 : this.reach <= 3 ? 0.5 : this.reach <= 8 ? 1 : this.reach <= 12 ? 2 : 5;
    pen.lineWidth = 1;
    pen.strokeStyle = colours.rings;
    for (let radius = step; radius * scale < far; radius += step) {
      pen.beginPath();
      pen.arc(cx, cy, radius * scale, 0, 2 * Math.PI);
      pen.stroke();
    }
    pen.beginPath();
    pen.moveTo(cx, cy - far);
    pen.lineTo(cx, cy + far);
    pen.moveTo(cx - far, cy);
    pen.lineTo(cx + far, cy);
    pen.stroke();
    pen.textAlign = "left";
    for (let radius = step; radius * scale < far; radius += step) {
      label(pen, `${+radius.toFixed(2)} m`, cx + 4, cy - radius * scale - 3, colours.soft, colours.card);
    }
  }

  scan(pen, scan, cx, cy, scale) {
    pen.fillStyle = colours.scan;
    const size = 3;
    for (let i = 0; i < scan.ranges.length; i++) {
      const range = scan.ranges[i];
      if (!(range < Infinity)) continue; // neither nothing there nor not measured
      const angle = scan.angles[i] + scan.yaw;
      const x = scan.x + range * Math.cos(angle);
      const y = scan.y + range * Math.sin(angle);
      pen.fillRect(cx - y * scale - size / 2, cy - x * scale - size / 2, size, size);
    }
  }

  footprint(pen, footprint, at, scale) {
    if (!footprint.length) return;
    outline(pen, footprint.map(at), true);
    pen.fillStyle = colours.body;
    pen.globalAlpha = 0.2;
    pen.fill();
    pen.globalAlpha = 1;
    pen.strokeStyle = colours.body;
    pen.lineWidth = 2;
    pen.stroke();
    const front = Math.max(...footprint.map(([x]) => x));
    const arrow = Math.max(front * 0.5, 6 / scale);
    outline(pen, [[front, 0], [front - arrow, arrow * 0.6], [front - arrow, -arrow * 0.6]].map(at), true);
    pen.fillStyle = colours.body;
    pen.fill();
  }

  item(pen, item, colour, at, scale) {
    pen.strokeStyle = pen.fillStyle = colour;
    pen.lineWidth = 2;
    const points = item.type === "Line" ? [item.start_m, item.end_m] : item.xy_m;
    if (item.type === "Histogram") return this.histogram(pen, item, colour, at, scale);
    if (!points?.length) return undefined;
    const placed = points.filter(([x, y]) => x !== null && y !== null).map(at);
    if (!placed.length) return undefined;
    if (item.type === "Points") {
      for (const [x, y] of placed) {
        pen.beginPath();
        pen.arc(x, y, 4, 0, 2 * Math.PI);
        pen.fill();
      }
    } else {
      outline(pen, placed, item.type === "Polygon");
      if (item.type === "Polygon") {
        pen.globalAlpha = 0.12;
        pen.fill();
        pen.globalAlpha = 1;
      }
      pen.stroke();
    }
    const [x, y] = placed.at(-1);
    label(pen, item.name, x + 7, y - 7, colour, colours.card);
    return undefined;
  }

  /** Values over bearing as spokes that grow outwards from a ring around the robot. */
  histogram(pen, item, colour, at, scale) {
    const top = Math.max(...item.values.filter((v) => v !== null), 1e-9);
    const [inner, length] = [0.3 * this.reach, 0.25 * this.reach];
    pen.globalAlpha = 0.45;
    pen.lineWidth = Math.max(1, 0.8 * Math.abs(item.step_rad) * inner * scale);
    pen.lineCap = "butt";
    item.values.forEach((value, i) => {
      if (!value) return;
      const angle = item.first_rad + i * item.step_rad;
      const outer = inner + (length * value) / top;
      outline(pen, [inner, outer].map((r) => at([r * Math.cos(angle), r * Math.sin(angle)])), false);
      pen.stroke();
    });
    pen.globalAlpha = 1;
    pen.lineCap = "round";
  }
}

function outline(pen, points, closed) {
  pen.beginPath();
  points.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  if (closed) pen.closePath();
}

// --------------------------------------------------------------------------------------------- camera

/** picture: {bitmap, width, height} or null; width and height are those that overlays count in. */
export function drawCamera(canvas, picture, drawings, source) {
  if (picture) canvas.style.aspectRatio = `${picture.width} / ${picture.height}`;
  const { pen, width, height } = prepared(canvas);
  if (!picture || !width) return;
  pen.drawImage(picture.bitmap, 0, 0, width, height);
  const [sx, sy] = [width / picture.width, height / picture.height];
  for (const { index, items } of drawings) {
    for (const item of items) {
      if (item.source !== source) continue;
      pen.strokeStyle = shade(index);
      pen.lineWidth = 2;
      if (item.type === "ImageBox") {
        const [left, top, right, bottom] = item.box_px;
        pen.strokeRect(left * sx, top * sy, (right - left) * sx, (bottom - top) * sy);
        const below = top * sy < 16 ? Math.min(bottom * sy - 4, top * sy + 14) : top * sy - 5;
        label(pen, item.name, left * sx + 2, below, shade(index), colours.card);
      } else if (item.type === "ImageLine") {
        const points = item.xy_px.filter(([x, y]) => x !== null && y !== null).map(([x, y]) => [x * sx, y * sy]);
        if (!points.length) continue;
        outline(pen, points, false);
        pen.stroke();
        label(pen, item.name, points.at(-1)[0] + 6, points.at(-1)[1] + 12, shade(index), colours.card);
      }
    }
  }
}
