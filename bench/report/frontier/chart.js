// Time against FLIP: milliseconds to the right on a log axis, closer to the best rung upwards; a point is chosen by a
// click.

// a name, not an address that is asked
const SVG = "http://www.w3.org/2000/svg";
const MARGIN = { left: 58, right: 18, top: 22, bottom: 46 };

function element(name, attributes, text) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

class Chart {
  // place: the element it fills; choose, point: called with a row, or null when the pointer leaves
  constructor(place, choose, point) {
    Object.assign(this, { place, choose, point, rows: [], budget: null, chosen: null, reference: "" });
    this.svg = element("svg", { role: "img", "aria-label": "time against FLIP" });
    place.append(this.svg);
    new ResizeObserver(() => this.draw()).observe(place);
  }

  // rows: {name, ms, low, high, flip, dominated, ghost}; a ghost is where another device had it
  show(rows) {
    this.rows = rows;
    const times = rows.flatMap((row) => [row.ms, row.ghost]).filter((ms) => ms > 0).map(Math.log10);
    const worst = Math.max(...rows.map((row) => row.flip), 1e-3);
    this.view = { x0: Math.min(...times) - 0.12, x1: Math.max(...times) + 0.2, y0: -0.06 * worst, y1: 1.1 * worst };
    this.draw();
  }

  get box() {
    const width = Math.max(this.place.clientWidth, 280), height = Math.max(this.place.clientHeight, 240);
    return { width, height, across: width - MARGIN.left - MARGIN.right, down: height - MARGIN.top - MARGIN.bottom };
  }

  x(ms) {
    return MARGIN.left + (this.box.across * (Math.log10(ms) - this.view.x0)) / (this.view.x1 - this.view.x0);
  }

  y(flip) {
    return MARGIN.top + (this.box.down * (flip - this.view.y0)) / (this.view.y1 - this.view.y0);
  }

  draw() {
    if (!this.view) return;
    const { width, height, across, down } = this.box, { svg, rows } = this;
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    svg.replaceChildren();
    const clip = element("clipPath", { id: "inside" });
    clip.append(element("rect", { x: MARGIN.left, y: MARGIN.top - 12, width: across + 12, height: down + 12 }));
    svg.append(clip);
    this.axes(across, down);
    const inside = element("g", { "clip-path": "url(#inside)" });
    svg.append(inside);
    if (this.budget) {
      const x = this.x(this.budget), bottom = MARGIN.top + down;
      inside.append(element("rect", { class: "over", x, y: MARGIN.top, width: Math.max(width - x, 0), height: down }));
      inside.append(element("line", { class: "budget", x1: x, x2: x, y1: MARGIN.top, y2: bottom }));
    }
    const front = rows.filter((row) => !row.dominated).sort((a, b) => a.ms - b.ms);
    inside.append(element("polyline", { class: "front", points: this.best(rows).map((row) => `${this.x(row.ms)},${this.y(row.flip)}`).join(" ") }));
    // the frontier above all else
    for (const row of [...rows.filter((row) => row.dominated), ...front]) inside.append(this.dot(row));
    this.labels(inside, this.best(rows), width);
  }

  // Rows that are more exact than every faster one, by their medians.
  best(rows) {
    let least = Infinity;
    return [...rows].sort((a, b) => a.ms - b.ms || a.flip - b.flip).filter(({ flip }) => flip < least && (least = flip, true));
  }

  dot(row) {
    const group = element("g", { class: `dot${row.dominated ? " dominated" : ""}${row === this.chosen ? " chosen" : ""}` });
    const x = this.x(row.ms), y = this.y(row.flip);
    if (row.ghost) {
      group.append(element("line", { class: "ghost", x1: this.x(row.ghost), x2: x, y1: y, y2: y }));
      group.append(element("circle", { class: "ghost", cx: this.x(row.ghost), cy: y, r: 3 }));
    }
    if (row.high > row.low) group.append(element("line", { class: "interval", x1: this.x(row.low), x2: this.x(row.high), y1: y, y2: y }));
    group.append(element("circle", { class: "reach", cx: x, cy: y, r: 13 }));
    group.append(element("circle", { class: "mark", cx: x, cy: y, r: row === this.chosen ? 7 : 5 }));
    group.addEventListener("click", () => this.choose(row));
    group.addEventListener("pointerenter", (event) => this.point(row, event));
    group.addEventListener("pointerleave", () => this.point(null));
    return group;
  }

  // Names beside the points of the frontier that have room, the chosen one first.
  labels(inside, front, width) {
    const taken = [];
    for (const row of [...front].sort((a, b) => (b === this.chosen) - (a === this.chosen))) {
      const x = this.x(row.ms), y = this.y(row.flip), long = 6.4 * row.name.length, left = x + 12 + long > width - 6;
      const box = { left: left ? x - 12 - long : x + 12, right: left ? x - 12 : x + 12 + long, top: y - 8, bottom: y + 8 };
      const clash = taken.some((other) => box.left < other.right && box.right > other.left && box.top < other.bottom && box.bottom > other.top);
      if (clash) continue;
      taken.push(box);
      inside.append(element("text", { class: `name${row === this.chosen ? " chosen" : ""}`, x: left ? x - 12 : x + 12, y: y + 4,
        "text-anchor": left ? "end" : "start" }, row.name));
    }
  }

  axes(across, down) {
    const { svg, view } = this, bottom = MARGIN.top + down;
    svg.append(element("rect", { class: "frame", x: MARGIN.left, y: MARGIN.top, width: across, height: down }));
    const decades = view.x1 - view.x0, parts = decades > 2.2 ? [1] : decades > 1.1 ? [1, 2, 5] : [1, 1.5, 2, 3, 4, 5, 6, 8];
    for (let power = Math.floor(view.x0); power <= view.x1; power++)
      for (const part of parts) {
        const ms = part * 10 ** power, x = this.x(ms);
        if (x < MARGIN.left - 1 || x > MARGIN.left + across + 1) continue;
        svg.append(element("line", { class: "grid", x1: x, x2: x, y1: MARGIN.top, y2: bottom }));
        svg.append(element("text", { class: "tick", x, y: bottom + 17, "text-anchor": "middle" }, Number(ms.toPrecision(3))));
      }
    const rough = (view.y1 - view.y0) / 5, power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((n) => n * power).find((n) => n >= rough);
    for (let flip = Math.ceil(view.y0 / step) * step; flip <= view.y1; flip += step) {
      if (flip < -1e-9) continue;
      const y = this.y(flip);
      svg.append(element("line", { class: "grid", x1: MARGIN.left, x2: MARGIN.left + across, y1: y, y2: y }));
      svg.append(element("text", { class: "tick", x: MARGIN.left - 7, y: y + 4, "text-anchor": "end" }, Number(flip.toFixed(5))));
    }
    svg.append(element("text", { class: "axis", x: MARGIN.left + across, y: bottom + 37, "text-anchor": "end" }, "ms a frame \u2192 slower"));
    svg.append(element("text", { class: "axis", x: MARGIN.left, y: bottom + 37 }, "\u2190 faster"));
    svg.append(element("text", { class: "axis", x: 8, y: 13 }, `FLIP: difference from ${this.reference} \u2191 better`));
  }
}
