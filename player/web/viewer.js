// What the reader touches: the camera, time, view modes; settings stand in the URL, so a link shows the same.

const VIEW_NAMES = { off: "plain", vertex: "quick shine", linear: "fine shine", network: "finest shine" };
const VIEW_HELP = {
  off: "The paper's colors: they depend on the place on the skin alone",
  vertex: "View dependence worked out at the vertices",
  linear: "View dependence per pixel, a linear map",
  network: "View dependence per pixel, a small network",
};
const BACKGROUND = [43 / 255, 45 / 255, 51 / 255];
// settings that a URL can hold: numbers with their usual value, least, most and step (0: any), and switches, usually on
const NUMBERS = {
  level: [0, 0, 99, 1], share: [1, 0.25, 1, 0], halvings: [0, 0, 3, 1], joints: [4, 1, 4, 1], speed: [1, 0.1, 4, 0],
};
const SWITCHES = ["edges", "play", "bar"];

function readSettings(home, avatar) {
  const given = new URLSearchParams(location.hash.slice(1));
  const number = (name, usual) => {
    const value = given.has(name) ? Number(given.get(name)) : usual;
    return Number.isFinite(value) ? value : usual;
  };
  const size = /^(\d{1,4})x(\d{1,4})$/.exec(given.get("size") || ""), settings = {};
  for (const [name, [usual, least, most, step]] of Object.entries(NUMBERS))
    settings[name] = limited(step ? Math.round(number(name, usual)) : number(name, usual), least, most);
  for (const name of SWITCHES) settings[name] = given.get(name) !== "0";
  return {
    ...settings,
    view: given.get("view") in VIEW_NAMES ? given.get("view") : null,
    level: Math.min(settings.level, avatar.levels.length - 1),
    frame: Math.max(number("frame", 0), 0),
    size: size && [1, 2].map((k) => Math.max(1, Number(size[k]))),
    camera: {
      target: ["x", "y", "z"].map((name, k) => number(name, home.target[k])),
      distance: limited(number("distance", home.distance), 0.05, 1000),
      azimuth: number("azimuth", home.azimuth),
      elevation: limited(number("elevation", home.elevation), -STEEPEST, STEEPEST),
      fov: home.fov,
    },
    fitted: !given.has("distance"),
  };
}

class Viewer {
  constructor(facts) {
    this.canvas = find("canvas");
    this.facts = facts;
    this.settings = readSettings(facts.camera, facts.avatar);
    this.drawing = new Drawing(this.canvas, facts, () => { this.dirty = true; });
    this.orbit = new Orbit(this.canvas, facts.camera, () => {
      this.dirty = true;
      this.remember();
    }, () => placeAt(this.motion, this.settings.frame).map((value, k) => value - this.motion.places[k]));
    const { settings, drawing: { views } } = this;
    Object.assign(this.orbit, { own: settings.camera, fitted: settings.fitted });
    if (!views.includes(settings.view)) settings.view = views.includes(facts.view) ? facts.view : "off";
    this.dirty = true;
    this.last = null;
  }

  // The coarsest level is there first: a picture while the rest is unpacked.
  async start() {
    const { drawing, settings } = this, { timing } = drawing, coarsest = this.facts.avatar.levels.length - 1;
    const wanted = settings.level;
    const [motion] = await Promise.all([unpackedMotion(this.facts.motion), drawing.load(coarsest)]);
    this.motion = motion;
    settings.frame = Math.min(settings.frame, motion.frames - 1);
    if (motion.frames === 1) settings.play = false;
    settings.level = coarsest;
    this.controls();
    this.resize();
    timing.first = this.drawn();
    document.body.classList.add("drawn");
    // let it be seen
    await new Promise((done) => setTimeout(done, 0));
    await drawing.load(wanted);
    settings.level = wanted;
    this.dirty = true;
    timing.whole = this.drawn();
    document.body.classList.add("ready");
    this.tell();
    requestAnimationFrame((now) => this.tick(now));
    setTimeout(() => this.price(), 400);
  }

  // Draw what has changed, and the milliseconds since the page was asked for.
  drawn() {
    if (this.dirty) this.draw();
    this.drawing.finish(this.shown.into);
    return performance.now();
  }

  get camera() {
    return this.orbit.camera;
  }

  resize() {
    const { size } = this.settings;
    this.canvas.classList.toggle("fixed", Boolean(size));
    if (size) Object.assign(this.canvas.style, { width: `${size[0]}px`, height: `${size[1]}px` });
    // at once: until it is drawn anew it is black
    if (this.drawing.fit(size)) this.draw();
  }

  draw() {
    const { drawing, settings } = this;
    this.dirty = true;
    if (drawing.gl.isContextLost() || !drawing.loaded(settings.level)) return;
    const samples = settings.edges ? drawing.samples : 0, pose = poseAt(this.motion, settings.frame);
    this.shown = drawing.paint(pose, this.camera, settings, BACKGROUND, samples);
    this.dirty = false;
  }

  tick(now) {
    const { settings, motion } = this;
    if (settings.play && this.last !== null) {
      const passed = Math.min((now - this.last) / 1000, 0.25) * motion.rate * settings.speed;
      settings.frame = (settings.frame + passed) % motion.frames;
      this.dirty = true;
    }
    this.last = now;
    if (this.dirty) {
      try {
        this.draw();
      } catch (error) {
        return failed(error);
      }
      this.time();
    }
    requestAnimationFrame((next) => this.tick(next));
  }

  // Change settings; what was asked for is drawn when it is unpacked.
  async set(changes) {
    Object.assign(this.settings, changes);
    await this.drawing.load(this.settings.level);
    this.dirty = true;
    this.tell();
    this.remember();
    clearTimeout(this.pricing);
    this.pricing = setTimeout(() => this.price(), 300);
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("select, input[type=range]")) return;
    const { settings, motion, drawing: { views } } = this, step = (by) =>
      this.set({ play: false, frame: (Math.floor(settings.frame + 1e-6) + by + motion.frames) % motion.frames });
    const does = {
      " ": () => this.set({ play: !settings.play && motion.frames > 1 }),
      ",": () => step(-1), ".": () => step(1), ArrowLeft: () => step(-1), ArrowRight: () => step(1),
      Home: () => this.set({ frame: 0 }), r: () => this.orbit.reset(),
      v: () => this.set({ view: views[(views.indexOf(settings.view) + 1) % views.length] }),
      g: () => this.set({ bar: !settings.bar }),
    }[event.key];
    if (!does || event.target.tagName === "BUTTON" && event.key === " ") return;
    event.preventDefault();
    does();
  }

  controls() {
    const { settings, drawing, motion, facts } = this;
    new ResizeObserver(() => this.resize()).observe(this.canvas);
    window.addEventListener("keydown", (event) => this.key(event));
    find("views").append(...drawing.views.map((view) => {
      const button = document.createElement("button");
      Object.assign(button, { textContent: VIEW_NAMES[view], title: VIEW_HELP[view] });
      button.dataset.view = view;
      button.addEventListener("click", () => this.set({ view }));
      return button;
    }));
    const select = find("level");
    select.append(...facts.avatar.levels.map(({ triangles }, k) => new Option(`${triangles.toLocaleString("en")} triangles`, k)));
    select.hidden = facts.avatar.levels.length < 2;
    select.addEventListener("change", () => this.set({ level: Number(select.value) }));
    find("edges").addEventListener("change", (event) => this.set({ edges: event.target.checked }));
    find("play").addEventListener("click", () => this.set({ play: !settings.play }));
    find("time").max = motion.frames - 1;
    find("time").addEventListener("input", (event) => this.set({ play: false, frame: Number(event.target.value) }));
    find("timeline").hidden = motion.frames < 2;
    find("home").addEventListener("click", () => this.orbit.reset());
  }

  tell() {
    const { settings, drawing } = this;
    for (const button of find("views").children)
      button.setAttribute("aria-pressed", String(button.dataset.view === settings.view));
    find("level").value = settings.level;
    find("edges").checked = settings.edges;
    find("play").textContent = settings.play ? "\u275a\u275a" : "\u25b6";
    find("play").title = settings.play ? "pause (space)" : "play (space)";
    document.body.classList.toggle("bare", !settings.bar);
    const { first, whole } = drawing.timing, steps = first === whole ? "" : `, whole after ${Math.round(whole)} ms`;
    find("facts").textContent = `first picture after ${Math.round(first)} ms${steps}, drawn by ${drawing.renderer}`;
    this.time();
  }

  time() {
    const frame = Math.floor(this.settings.frame + 1e-6);
    find("time").value = frame;
    find("when").textContent = `${(frame / this.motion.rate).toFixed(1)} s`;
  }

  // What a frame of these settings costs on this device.
  price() {
    if (document.hidden || this.drawing.gl.isContextLost()) return;
    const { width, height } = this.canvas, poses = [poseAt(this.motion, this.settings.frame)];
    const ms = this.drawing.measure(poses, this.camera, this.settings, [width, height], { groups: 3, atLeast: 10 });
    find("price").textContent = `${ms < 10 ? ms.toFixed(1) : Math.round(ms)} ms a frame here`;
    this.dirty = true;
  }

  // The URL of what is shown.
  remember() {
    remember(() => {
      const { settings, orbit } = this, { target, distance, azimuth, elevation } = orbit.own;
      const words = { view: settings.view };
      for (const [name, [usual]] of Object.entries(NUMBERS)) if (settings[name] !== usual) words[name] = settings[name];
      for (const name of SWITCHES) if (!settings[name]) words[name] = 0;
      if (settings.size) words.size = settings.size.join("x");
      if (!settings.play) words.frame = Math.round(settings.frame * 100) / 100;
      if (!orbit.fitted) {
        const [x, y, z] = target, camera = { distance, azimuth, elevation, x, y, z };
        for (const [name, value] of Object.entries(camera)) words[name] = Math.round(value * 1e4) / 1e4;
      }
      return words;
    });
  }
}

async function view() {
  // for whoever embeds the page, and for tests
  window.selfscan = new Viewer(JSON.parse(find("page-facts").textContent));
  await window.selfscan.start();
}

view().catch(failed);
