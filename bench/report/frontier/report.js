// The page of accuracy against time: a budget, what it buys, the same frame in each rung, and the avatar drawn and timed
// on the reader's own device.

const BACKGROUND = [0, 0, 0];
const PARTS = { whole: "person", head: "head", hands: "hands" };
// how FLIP is put into words: our own scale, told below the table
const WORDS = [[0.005, "nobody will tell them apart"], [0.015, "seen only when the two are flicked back and forth"],
  [0.035, "seen side by side"], [1, "seen at once"]];

function milliseconds(ms) {
  return ms < 10 ? ms.toFixed(ms < 1 ? 2 : 1) : Math.round(ms).toLocaleString("en");
}

// A rung is dominated when another is surely faster (their intervals do not overlap) and no less exact.
function marked(rows) {
  return rows.map((row) => ({ ...row, dominated: rows.some((other) => other.high < row.low && other.flip <= row.flip) }));
}

function made(kind, textContent) {
  return Object.assign(document.createElement(kind), { textContent });
}

class Report {
  constructor(facts) {
    this.facts = facts;
    const words = new URLSearchParams(location.hash.slice(1));
    this.reference = facts.references.find(({ key }) => key === words.get("with")) || facts.references[0];
    // by name: {ms, low, high} on this device
    this.here = new Map();
    this.times = "there";
    this.part = words.get("part") in PARTS ? words.get("part") : "whole";
    this.chart = new Chart(find("chart"), (row) => this.setBudget(row.ms, row), (row, event) => this.tooltip(row, event));
    this.refer();
    this.provenance();
    this.controls();
    // whether the reader chose the budget
    this.asked = Number(words.get("budget")) > 0;
    this.choices(Number(words.get("budget")) || null);
    this.table();
  }

  // Where it was measured, and what a reader must know when that machine was not idle.
  provenance() {
    const { machine, size, frames, rounds, warning } = this.facts.result;
    find("warning").textContent = warning || "";
    find("warning").hidden = !warning;
    find("machine").textContent = `The machine of the bench: ${machine.cpu}, ${machine.cores} cores, ${machine.renderer} `
      + `(${machine.context}), commit ${machine.commit}; ${size.join(" x ")} pixels, ${frames} frames, ${rounds} rounds.`;
  }

  // Rows with their scores against what they are compared with. Beside the best that the player draws stand only those
  // that it can draw.
  refer() {
    const { key, scores, name } = this.reference;
    this.all = this.facts.result.rungs.map((row, k) => ({ ...row, ...(scores ? row[scores] : {}), number: k })).map((row) => ({
      ...row, ms: row.ms_median, low: row.ms_interval[0], high: row.ms_interval[1], flip: row.flip || 0,
    })).filter((row) => key !== "baked" || row.draw);
    // none where it is a true picture
    this.best = this.all.find((row) => row.name === name) || null;
    this.chart.reference = name;
  }

  // Rows as timed by the bench machine or here, with where the other had them.
  get rows() {
    if (this.times === "there") return this.all.map((row) => ({ ...row, ghost: null }));
    return marked(this.all.filter((row) => this.here.has(row.name)).map((row) => (
      { ...row, ...this.here.get(row.name), ghost: row.ms_median })));
  }

  // The scale of the slider, from the fastest rung to the slowest, and a budget on it.
  choices(budget) {
    const rows = this.rows, times = rows.map((row) => row.ms);
    this.low = Math.min(...times) * 0.97;
    this.high = Math.max(...times) * 1.05;
    this.chart.show(rows);
    this.setBudget(limited(budget || this.usual(rows), this.low, this.high));
  }

  // In the middle of the frontier.
  usual(rows) {
    const drawn = rows.filter((row) => row.draw), front = drawn.filter((row) => !row.dominated);
    const chosen = (front.length ? front : drawn.length ? drawn : rows).sort((a, b) => a.ms - b.ms);
    return chosen[Math.floor(chosen.length / 2)].ms * 1.02;
  }

  setBudget(budget, asked = null) {
    this.budget = budget;
    const rows = this.chart.rows, fits = rows.filter((row) => row.ms <= budget * 1.0001);
    this.row = asked || fits.sort((a, b) => a.flip - b.flip || a.ms - b.ms)[0] || [...rows].sort((a, b) => a.ms - b.ms)[0];
    find("budget").value = (1000 * Math.log(budget / this.low)) / Math.log(this.high / this.low);
    this.chart.chosen = rows.find((row) => row.name === this.row.name);
    this.chart.budget = budget;
    this.chart.draw();
    this.answer(fits.length > 0);
    this.compare();
    if (this.player && this.row.draw) this.player.choose(this.row.draw);
    this.remember();
  }

  // What the budget buys, in a sentence or two.
  answer(fits) {
    const { row, budget, reference } = this, rows = this.chart.rows, own = rows.find((other) => other.name === reference.name);
    const where = this.times === "here" ? "on your device" : "on the machine of the bench";
    if (document.activeElement !== find("spent")) find("spent").value = milliseconds(budget).replace(",", "");
    find("rate").textContent = `${Math.round(1000 / budget).toLocaleString("en")} frames a second`;
    const parts = [];
    if (!fits) parts.push(`Nothing is that fast ${where}. The fastest is `);
    else parts.push("You get ");
    parts.push(["strong", row.name], ` (${milliseconds(row.ms)} ms ${where}). `);
    if (row.name === reference.name) parts.push("It is what the others are compared with. ");
    else {
      const word = WORDS.find(([most]) => row.flip <= most)[1], ms = own || this.best;
      const regions = Object.entries(row.parts || {}).map(([name, { flip }]) => `${name} ${flip.toFixed(3)}`).join(", ");
      parts.push("You lose ", ["strong", `FLIP ${row.flip.toFixed(3)}`], ` beside ${reference.name}${ms ? ` (${milliseconds(ms.ms)} ms)` : ""}`,
        regions ? `; ${regions}` : "", `: ${word}. `);
    }
    if (reference.key !== "truth" && row.against_truth && this.best)
      parts.push(`From true pictures it is FLIP ${row.against_truth.flip.toFixed(3)} away, ${reference.name} ${this.best.against_truth.flip.toFixed(3)}. `);
    const next = rows.filter((other) => other.flip < row.flip && !other.dominated && other.ms > row.ms).sort((a, b) => a.ms - b.ms)[0];
    if (next) parts.push(`The next better one, ${next.name}, costs ${milliseconds(next.ms - row.ms)} ms more.`);
    find("answer").replaceChildren(...parts.map((part) => (typeof part === "string" ? part : made(...part))));
  }

  compare() {
    const { row, reference } = this;
    const shown = { best: reference.picture, rung: `picture${row.number}`, difference: `difference-${reference.key}-${row.number}` };
    // pictures of the page, by the ids of their bytes
    for (const [place, name] of Object.entries(shown)) find(place).src = `data:image/webp;base64,${find(name).textContent.trim()}`;
    find("best-name").textContent = `compared with: ${reference.name}`;
    find("rung-name").textContent = row.name;
    this.zoom();
  }

  // Show the whole person, the head or a hand: the same pixels, larger.
  zoom() {
    const { size: [width, height], boxes } = this.facts.picture;
    const named = { head: "head", hands: "hand_left" in boxes ? "hand_left" : "hand_right" }[this.part];
    const [left, top, across, down] = boxes[named] || [0, 0, width, height];
    const shape = width / height, wide = Math.max(across, down * shape) * 1.06, high = wide / shape;
    const [x, y] = named ? [left + across / 2 - wide / 2, top + down / 2 - high / 2] : [0, 0], scale = named ? width / wide : 1;
    for (const image of document.querySelectorAll(".picture img")) {
      image.style.transform = `scale(${scale}) translate(${(-100 * x) / width}%, ${(-100 * y) / height}%)`;
      image.classList.toggle("near", Boolean(named));
    }
    for (const [place, key] of [["parts", this.part], ["references", this.reference.key]])
      for (const button of find(place).children) button.setAttribute("aria-pressed", String(button.dataset.key === key));
  }

  tooltip(row, event) {
    const tip = find("tip");
    tip.hidden = !row;
    if (!row) return;
    const box = find("chart").getBoundingClientRect();
    tip.style.left = `${limited(event.clientX - box.left + 14, 0, box.width - 240)}px`;
    tip.style.top = `${event.clientY - box.top + 16}px`;
    const lines = [row.name, `${milliseconds(row.ms)} ms (${milliseconds(row.low)} to ${milliseconds(row.high)})`,
      row.name === this.reference.name ? "what the others are compared with" : `FLIP ${row.flip.toFixed(4)}, PSNR ${row.psnr_db ? row.psnr_db.toFixed(1) : "-"} dB`];
    lines.push(`${(row.bytes / 1e6).toFixed(0)} MB of graphics memory`);
    if (row.ghost) lines.push(`${milliseconds(row.ghost)} ms on the machine of the bench`);
    if (row.dominated) lines.push(`dominated${row.dominated_by && this.times === "there" ? ` by ${row.dominated_by}` : ""}`);
    tip.replaceChildren(...lines.map((line) => made("div", line)));
  }

  controls() {
    const ask = (budget) => {
      if (!(budget > 0)) return;
      this.asked = true;
      this.setBudget(budget);
    };
    const button = (text, key, act) => {
      const one = made("button", text);
      one.dataset.key = key;
      one.addEventListener("click", () => { act(); this.remember(); });
      return one;
    };
    const { size: [width, height], boxes } = this.facts.picture, { references } = this.facts;
    const parts = { whole: true, head: "head" in boxes, hands: "hand_left" in boxes || "hand_right" in boxes };
    find("budget").addEventListener("input", ({ target }) => ask(this.low * (this.high / this.low) ** (target.value / 1000)));
    find("spent").addEventListener("input", ({ target }) => ask(Number(target.value)));
    find("parts").append(...Object.keys(PARTS).filter((part) => parts[part]).map((part) => (
      button(PARTS[part], part, () => { this.part = part; this.zoom(); }))));
    find("references").hidden = references.length < 2;
    find("references").append(...references.map((reference) => button(`compared with ${reference.name}`, reference.key, () => {
      this.reference = reference;
      this.refer();
      this.show(this.times);
    })));
    // as wide as the column, unless it would be higher than 62 % of the window: both keep the picture's shape
    for (const box of document.querySelectorAll(".picture"))
      Object.assign(box.style, { aspectRatio: `${width} / ${height}`, width: `min(100%, ${(62 * width) / height}vh)` });
    const { halvings } = this.facts;
    if (halvings) find("live-name").textContent += `; textures at 1/${2 ** halvings} of their sides, to fit this page`;
    find("difference-name").textContent = `difference, ${this.facts.enlarged} times enlarged`;
    for (const name of ["there", "here"]) find(name).addEventListener("click", () => this.show(name));
  }

  show(times) {
    this.times = times;
    for (const name of ["there", "here"]) find(name).setAttribute("aria-pressed", String(name === times));
    const name = this.row.name;
    this.choices(this.asked ? this.budget : null);
    // who chose no budget keeps the rung
    const same = this.chart.rows.find((row) => row.name === name);
    if (same && !this.asked) this.setBudget(same.ms * 1.0001);
    this.table();
  }

  table() {
    const { columns } = this.facts, head = ["rung", "ms (95 %)", "here ms", ...columns.map(({ title }) => title), ""];
    const number = (value, digits = 2, scale = 1) => (value === null || value === undefined ? "" : (scale * value).toFixed(digits));
    const held = (row, path) => path.reduce((value, key) => value && value[key], row);
    const line = (cells, kind) => {
      const row = made("tr", "");
      row.append(...cells.map((cell) => made(kind, cell)));
      return row;
    };
    const rows = this.all.map((row) => {
      const here = this.here.get(row.name);
      const shown = line([row.name, `${number(row.ms_median)} (${number(row.low)} to ${number(row.high)})`, number(here && here.ms),
        ...columns.map(({ path, digits, scale }) => number(held(row, path), digits, scale)),
        row.dominated ? `dominated by ${row.dominated_by}` : ""], "td");
      shown.addEventListener("click", () => this.setBudget((this.chart.rows.find((own) => own.name === row.name) || row).ms * 1.0001, row));
      return shown;
    });
    const titles = line(head, "th");
    for (const { title, better } of columns) if (better) titles.children[head.indexOf(title)].title = `${better} is better`;
    find("rows").replaceChildren(titles, ...rows);
  }

  remember() {
    remember(() => ({ budget: this.budget.toPrecision(3), part: this.part, with: this.reference.key }));
  }
}

// The avatar, drawn here in the chosen rung.
class Player {
  constructor(facts, report) {
    this.canvas = find("canvas");
    this.drawing = new Drawing(this.canvas, facts);
    Object.assign(this, { facts, report, rung: null, frame: 0, last: null });
    this.orbit = new Orbit(this.canvas, facts.camera, () => {});
  }

  async start() {
    this.motion = await unpackedMotion(this.facts.motion);
    await this.choose(this.report.row.draw || this.report.all.find((row) => row.draw).draw);
    this.draw();
    requestAnimationFrame((now) => this.tick(now));
  }

  async choose(rung) {
    this.wanted = rung;
    await this.drawing.load(rung.level);
    if (this.wanted === rung) this.rung = rung;
  }

  draw() {
    this.drawing.fit();
    this.shown = this.drawing.paint(poseAt(this.motion, this.frame), this.orbit.camera, this.rung, BACKGROUND);
  }

  tick(now) {
    // the clock of the motion does not stand still while rungs are timed
    if (this.last !== null) this.frame = (this.frame + (Math.min(now - this.last, 250) / 1000) * this.motion.rate) % this.motion.frames;
    this.last = now;
    if (!this.drawing.gl.isContextLost() && !document.hidden) this.draw();
    requestAnimationFrame((next) => this.tick(next));
  }

  // Time every baked rung on this device, a slice between frames at a time, in alternating rounds.
  async measure(rounds = 5) {
    const { report, drawing, facts, motion } = this, rows = report.facts.result.rungs.filter((row) => row.draw), times = new Map();
    const { size } = report.facts.result, pause = () => new Promise((done) => setTimeout(done, 20));
    const poses = [0.2, 0.4, 0.6, 0.8].map((share) => poseAt(motion, Math.floor(share * (motion.frames - 1))));
    let done = 0;
    for (let round = 0; round < rounds; round++)
      for (const row of rows) {
        await drawing.load(row.draw.level);
        await pause();
        const ms = drawing.measure(poses, facts.camera, row.draw, size, { groups: 1, atLeast: 8 });
        times.set(row.name, [...(times.get(row.name) || []), ms]);
        find("state").textContent = `timing every rung on your device: ${Math.round((100 * ++done) / (rounds * rows.length))} %`;
      }
    for (const [name, list] of times) {
      list.sort((a, b) => a - b);
      report.here.set(name, { ms: list[list.length >> 1], low: list[0], high: list[list.length - 1] });
    }
    find("state").textContent = `timed on your device: ${drawing.renderer}, ${size.join(" x ")}`;
    find("here").disabled = false;
    report.show("here");
  }
}

async function main() {
  const facts = JSON.parse(find("page-facts").textContent), report = new Report(facts);
  window.selfscan = report;
  document.body.classList.toggle("alone", !facts.player);
  if (facts.player) {
    try {
      report.player = new Player(facts.player, report);
      await report.player.start();
    } catch (error) {
      failed(error);
      report.player = null;
    }
  } else find("state").textContent = "The avatar itself would make this page larger than 12 MB: `selfscan web` writes it.";
  document.body.classList.add("ready");
  if (report.player) setTimeout(() => report.player.measure().catch(failed), 600);
}

main().catch(failed);
