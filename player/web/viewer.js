// What the reader touches: the camera, time, view modes; settings stand in the URL, so a link shows the same.

const VIEW_NAMES = { off: "plain", vertex: "quick shine", linear: "fine shine", network: "finest shine" };
const VIEW_HELP = {
  off: "The paper's colors: they depend on the place on the skin alone",
  vertex: "View dependence worked out at the vertices",
  linear: "View dependence per pixel, a linear map",
  network: "View dependence per pixel, a small network",
};
const BACKGROUND = [43 / 255, 45 / 255, 51 / 255];
const find = (id) => document.getElementById(id);

// Settings that a URL can hold, short names for links: its default, as text.
function readSettings(home, avatar) {
  const given = new URLSearchParams(location.hash.slice(1));
  const number = (name, usual) => {
    const value = given.has(name) ? Number(given.get(name)) : usual;
    return Number.isFinite(value) ? value : usual;
  };
  const size = /^(\d{1,4})x(\d{1,4})$/.exec(given.get("size") || "");
  return {
    view: given.get("view") in VIEW_NAMES ? given.get("view") : null,
    level: limited(Math.round(number("level", 0)), 0, avatar.levels.length - 1),
    share: limited(number("share", 1), 0.25, 1),
    halvings: limited(Math.round(number("halvings", 0)), 0, 3),
    joints: limited(Math.round(number("joints", 4)), 1, 4),
    edges: given.get("edges") !== "0",
    play: given.get("play") !== "0",
    frame: Math.max(number("frame", 0), 0),
    speed: limited(number("speed", 1), 0.1, 4),
    bar: given.get("bar") !== "0",
    size: size && [Number(size[1]), Number(size[2])],
    camera: {
      target: ["x", "y", "z"].map((name, k) => number(name, home.target[k])),
      distance: limited(number("distance", home.distance), 0.05, 1000),
      azimuth: number("azimuth", home.azimuth),
      elevation: limited(number("elevation", home.elevation), -STEEPEST, STEEPEST),
      fov: home.fov,
      narrow: home.narrow,
    },
    fitted: !given.has("distance"),
  };
}

class Viewer {
  constructor(facts, programs, motion, bytes) {
    this.canvas = find("canvas");
    this.facts = facts;
    this.settings = readSettings(facts.camera, facts.avatar);
    this.drawing = new Drawing(this.canvas, facts.avatar, programs, bytes);
    this.orbit = new Orbit(this.canvas, facts.camera, () => {
      this.dirty = true;
      this.remember();
    });
    Object.assign(this.orbit, { own: this.settings.camera, fitted: this.settings.fitted });
    const { views } = this.drawing, settings = this.settings;
    if (!views.includes(settings.view)) settings.view = views.includes(facts.view) ? facts.view : "off";
    this.motionFacts = motion;
    this.dirty = true;
    this.last = null;
    this.errors = [];
  }

  // The coarsest level is there first: a picture while the rest is unpacked.
  async start() {
    const { drawing, settings } = this, { timing } = drawing, coarsest = this.facts.avatar.levels.length - 1;
    const wanted = settings.level;
    const [motion] = await Promise.all([
      unpackedMotion(this.motionFacts, drawing.bytes("motion")), drawing.load(coarsest),
    ]);
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
    timing.whole = this.drawn();
    document.body.classList.add("ready");
    this.tell();
    requestAnimationFrame((now) => this.tick(now));
    setTimeout(() => this.price(), 400);
  }

  // Draw, and the milliseconds since the page was asked for.
  drawn() {
    this.draw();
    this.drawing.finish(this.shown.into);
    return performance.now();
  }

  get rung() {
    const { view, level, halvings, joints } = this.settings;
    return { view, level, halvings, joints };
  }

  // Pixels of the canvas, and those drawn.
  get pixels() {
    const { share } = this.settings, { width, height } = this.canvas;
    return [Math.max(1, Math.round(width * share)), Math.max(1, Math.round(height * share))];
  }

  get camera() {
    return this.orbit.camera;
  }

  resize() {
    const { size } = this.settings, density = Math.min(window.devicePixelRatio || 1, 2);
    const box = this.canvas.getBoundingClientRect();
    const [width, height] = size || [Math.round(box.width * density), Math.round(box.height * density)];
    this.canvas.classList.toggle("fixed", Boolean(size));
    if (size) Object.assign(this.canvas.style, { width: `${width}px`, height: `${height}px` });
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = Math.max(width, 1);
      this.canvas.height = Math.max(height, 1);
      this.dirty = true;
    }
  }

  draw() {
    const { drawing, settings } = this, [width, height] = this.pixels;
    if (drawing.gl.isContextLost() || !drawing.loaded(settings.level)) return;
    const samples = settings.edges ? drawing.samples : 0, pose = poseAt(this.motion, settings.frame);
    const drawn = drawing.frame(pose, this.camera, this.rung, width, height, BACKGROUND, samples);
    this.shown = { into: drawing.resolved(drawn, width, height, samples), width, height };
    drawing.show(this.shown.into, width, height);
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

  controls() {
    const { canvas } = this;
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => {
      this.drawing.begin();
      this.dirty = true;
    });
    new ResizeObserver(() => this.resize()).observe(canvas);
    window.addEventListener("keydown", (event) => this.key(event));
    this.buttons();
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("select, input[type=range]")) return;
    const { settings, motion } = this, step = (by) =>
      this.set({ play: false, frame: (Math.floor(settings.frame + 1e-6) + by + motion.frames) % motion.frames });
    const does = {
      " ": () => this.set({ play: !settings.play && motion.frames > 1 }),
      ",": () => step(-1), ".": () => step(1), ArrowLeft: () => step(-1), ArrowRight: () => step(1),
      Home: () => this.set({ frame: 0 }), r: () => this.orbit.reset(),
      v: () => this.nextView(), g: () => this.set({ bar: !settings.bar }),
    }[event.key];
    if (!does || event.target.tagName === "BUTTON" && event.key === " ") return;
    event.preventDefault();
    does();
  }

  nextView() {
    const { views } = this.drawing;
    this.set({ view: views[(views.indexOf(this.settings.view) + 1) % views.length] });
  }

  buttons() {
    const { settings, drawing, motion, facts } = this;
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
    const [width, height] = this.pixels, poses = [poseAt(this.motion, this.settings.frame)];
    const { ms } = this.drawing.measure(poses, this.camera, this.rung, width, height, { groups: 3, atLeast: 10 });
    this.drawing.timing.ms = ms;
    find("price").textContent = `${ms < 10 ? ms.toFixed(1) : Math.round(ms)} ms a frame here`;
    this.dirty = true;
  }

  // The URL of what is shown. A page from a file may not always change its own.
  remember() {
    clearTimeout(this.writing);
    this.writing = setTimeout(() => {
      const { settings, orbit } = this, { target, distance, azimuth, elevation } = orbit.own;
      const words = { view: settings.view };
      if (settings.level) words.level = settings.level;
      if (settings.halvings) words.halvings = settings.halvings;
      if (settings.joints !== 4) words.joints = settings.joints;
      if (settings.share !== 1) words.share = settings.share;
      if (!settings.edges) words.edges = 0;
      if (!settings.bar) words.bar = 0;
      if (settings.size) words.size = settings.size.join("x");
      if (!settings.play) Object.assign(words, { play: 0, frame: Math.round(settings.frame * 100) / 100 });
      if (!orbit.fitted) {
        const [x, y, z] = target, camera = { distance, azimuth, elevation, x, y, z };
        for (const [name, value] of Object.entries(camera)) words[name] = Math.round(value * 1e4) / 1e4;
      }
      try {
        history.replaceState(null, "", `#${new URLSearchParams(words)}`);
      } catch {
        this.link = words;
      }
    }, 300);
  }
}

function failed(error) {
  const text = error && error.message ? error.message : String(error);
  find("failure").textContent = text;
  document.body.classList.add("failed");
}

async function view() {
  const facts = JSON.parse(find("page-facts").textContent);
  const viewer = new Viewer(facts, facts.programs, facts.motion, pageBytes);
  // for whoever embeds the page, and for tests
  window.selfscan = viewer;
  await viewer.start();
  return viewer;
}
