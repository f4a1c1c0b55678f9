// Draws one avatar in WebGL2, as player/scene/renderer.py does: the same shaders, filters and order of triangles.

const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;
const BLOCKS = { Frame: 0, Bones: 1, Turns: 2 };
// name, components, of which array, their type, bytes from one to the next (0: no others lie between) and to the first
const ATTRIBUTES = [
  ["position", 3, "position", "FLOAT", 0, 0], ["uv", 2, "uv", "FLOAT", 0, 0], ["view_mean", 3, "view_mean", "FLOAT", 0, 0],
  ["view_seen", 1, "view_seen", "FLOAT", 0, 0], ["view_q0", 3, "view_q", "FLOAT", 24, 0],
  ["view_q1", 3, "view_q", "FLOAT", 24, 12], ["joints", 4, "joints", "UNSIGNED_BYTE", 0, 0],
  ["weights", 4, "weights", "UNSIGNED_BYTE", 0, 0], ["face_slot", 1, "face_slot", "UNSIGNED_INT", 0, 0],
];
// attributes that are whole numbers in the shader too
const WHOLE = ["joints", "face_slot"];

// Pixels that are drawn for so many; share: of each side.
function drawnSize(share, width, height) {
  return [width, height].map((side) => Math.max(1, Math.round(side * share)));
}

// Mipmaps worth having: avatar/texture.py, mip_levels.
function mipLevels(size) {
  const bits = (n) => 32 - Math.clz32(n), largest = Math.max(...size);
  return Math.min(bits(Math.max(2, largest >> 8)), bits(largest));
}

// The heaviest `joints` of each vertex's four weights, which stand first, scaled to sum to 255: player/budget/rung.py.
function strongest(weights, joints) {
  const out = new Uint8Array(weights.length);
  for (let k = 0; k < weights.length; k += 4) {
    let sum = 0, left = 255;
    for (let i = 0; i < joints; i++) sum += weights[k + i];
    for (let i = 0; i < joints; i++) left -= out[k + i] = Math.floor((255 * weights[k + i]) / sum);
    out[k] += left;
  }
  return out;
}

class Drawing {
  // facts: the player's, with an avatar, and programs by view mode; changed: called when all has to be drawn anew
  constructor(canvas, { avatar, programs }, changed = () => {}) {
    Object.assign(this, { canvas, avatar, sources: programs, views: Object.keys(programs) });
    this.skeleton = {
      parents: avatar.parents,
      offsets: avatar.offsets,
      jointFromCanonical: avatar.jointFromCanonical.map((row) => Float64Array.from(row)),
    };
    // unpacked, by level: they outlive the context
    this.content = new Map();
    this.timing = {};
    // a frame is drawn anew whenever it may be shown: the browser need not keep a copy of the last one
    const settings = { antialias: false, alpha: false, depth: false, stencil: false, powerPreference: "high-performance" };
    this.gl = canvas.getContext("webgl2", settings);
    if (!this.gl) throw new Error("This browser has no WebGL 2, or it is turned off.");
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => {
      this.begin();
      changed();
    });
    this.begin();
  }

  // What belongs to a context, made anew when the browser has lost it.
  begin() {
    const gl = this.gl, info = gl.getExtension("WEBGL_debug_renderer_info");
    this.renderer = gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
    this.software = SOFTWARE.test(this.renderer);
    this.anisotropy = gl.getExtension("EXT_texture_filter_anisotropic");
    this.samples = Math.min(4, gl.getParameter(gl.MAX_SAMPLES));
    this.made = new Map();
    this.images = new Map();
    this.targets = new Map();
    this.buffers = Object.entries(BLOCKS).map(([name, unit]) => {
      const buffer = gl.createBuffer();
      gl.bindBuffer(gl.UNIFORM_BUFFER, buffer);
      gl.bufferData(gl.UNIFORM_BUFFER, { Frame: 80, Bones: 52 * 48, Turns: 52 * 16 }[name], gl.DYNAMIC_DRAW);
      gl.bindBufferBase(gl.UNIFORM_BUFFER, unit, buffer);
      return buffer;
    });
  }

  // Unpack a level's mesh and textures.
  async load(level) {
    if (!this.content.has(level)) this.content.set(level, this.unpack(level));
    return this.content.get(level);
  }

  async unpack(level) {
    const facts = this.avatar.levels[level], name = `level${level}`;
    const [mesh, color, features] = await Promise.all([
      unpackedMesh(facts, pageBytes(`${name}.mesh`)),
      unpackedColor(pageBytes(`${name}.color`)),
      facts.features ? unpackedFeatures(facts.features, pageBytes(`${name}.features`)) : null,
    ]);
    const face = await unpackedFace(facts.face, mesh, `${name}.face`);
    this.content.set(level, { mesh, color, features, face });
    return this.content.get(level);
  }

  loaded(level) {
    return !(this.content.get(level) instanceof Promise) && this.content.has(level);
  }

  // joints: how many a vertex follows at most, as player/budget/rung.py prepares them.
  program(view, joints) {
    return this.kept(`program ${view} ${joints}`, () => {
      const gl = this.gl, program = gl.createProgram(), source = this.sources[view];
      const bias = `#version 300 es\n#define MIP_BIAS ${this.software ? "-1.0" : "0.0"}\n`;
      for (const [kind, text] of [[gl.VERTEX_SHADER, source.vertex], [gl.FRAGMENT_SHADER, source.fragment]]) {
        const shader = gl.createShader(kind);
        gl.shaderSource(shader, text.replace("#version 300 es\n", bias).replace("INFLUENCES = 4", `INFLUENCES = ${joints}`));
        gl.compileShader(shader);
        if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost())
          throw new Error(`shader ${view}: ${gl.getShaderInfoLog(shader)}`);
        gl.attachShader(program, shader);
      }
      gl.linkProgram(program);
      if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost())
        throw new Error(`shader ${view}: ${gl.getProgramInfoLog(program)}`);
      for (const [name, unit] of Object.entries(BLOCKS)) {
        const index = gl.getUniformBlockIndex(program, name);
        if (index !== gl.INVALID_INDEX) gl.uniformBlockBinding(program, index, unit);
      }
      gl.useProgram(program);
      for (const [name, unit] of [["base_color", 0], ["features", 1], ["face_offsets", FACE_UNIT]])
        gl.uniform1i(gl.getUniformLocation(program, name), unit);
      return program;
    });
  }

  kept(key, make) {
    if (!this.made.has(key)) this.made.set(key, make());
    return this.made.get(key);
  }

  // The mesh of a level as a program reads it.
  array(level, view, joints) {
    return this.kept(`array ${level} ${view} ${joints}`, () => {
      const gl = this.gl, { mesh } = this.content.get(level), program = this.program(view, joints);
      const array = gl.createVertexArray();
      const weights = (name) => name === "weights" && joints < 4;
      const buffer = (name) => this.kept(`buffer ${level} ${name}${weights(name) ? joints : ""}`, () => {
        const made = gl.createBuffer(), target = name === "faces" ? gl.ELEMENT_ARRAY_BUFFER : gl.ARRAY_BUFFER;
        gl.bindVertexArray(null);
        gl.bindBuffer(target, made);
        gl.bufferData(target, weights(name) ? strongest(mesh.weights, joints) : mesh[name], gl.STATIC_DRAW);
        return made;
      });
      for (const [attribute, count, name, type, step, first] of ATTRIBUTES) {
        const place = gl.getAttribLocation(program, attribute);
        if (place < 0 || !mesh[name]) continue;
        const made = buffer(name);
        gl.bindVertexArray(array);
        gl.bindBuffer(gl.ARRAY_BUFFER, made);
        gl.enableVertexAttribArray(place);
        if (WHOLE.includes(attribute)) gl.vertexAttribIPointer(place, count, gl[type], step, first);
        else gl.vertexAttribPointer(place, count, gl[type], name === "weights", step, first);
      }
      const faces = buffer("faces");
      gl.bindVertexArray(array);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, faces);
      gl.bindVertexArray(null);
      return array;
    });
  }

  // A level's textures: base color, then features.
  textures(level, halvings) {
    const { color, features } = this.content.get(level), facts = this.avatar.levels[level], gl = this.gl;
    const found = this.kept(`textures ${level}`, () => [
      this.texture(color, facts.color.size, false),
      ...(features ? [this.texture(features, facts.features.size, true)] : []),
    ]);
    for (const [unit, { texture, size }] of found.entries()) {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      if (this.images.get(texture) === halvings) continue;
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_BASE_LEVEL, halvings);
      const last = halvings + mipLevels(size.map((side) => side >> halvings)) - 1;
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAX_LEVEL, last);
      this.images.set(texture, halvings);
    }
  }

  texture(image, size, coarse) {
    const gl = this.gl, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false);
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    gl.pixelStorei(gl.UNPACK_FLIP_Y_WEBGL, false);
    const given = image instanceof Uint8Array ? [...size, 0, gl.RGBA, gl.UNSIGNED_BYTE, image]
      : [gl.RGBA, gl.UNSIGNED_BYTE, image];
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, ...given);
    gl.generateMipmap(gl.TEXTURE_2D);
    // as player/gl/texture.py: a nearest mip on software, where the finer one is read (MIP_BIAS)
    const smaller = !this.software ? gl.LINEAR_MIPMAP_LINEAR : coarse ? gl.NEAREST_MIPMAP_NEAREST : gl.LINEAR_MIPMAP_NEAREST;
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, smaller);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    if (!this.software && this.anisotropy)
      gl.texParameterf(gl.TEXTURE_2D, this.anisotropy.TEXTURE_MAX_ANISOTROPY_EXT, 8);
    return { texture, size };
  }

  // The face of a level in a pose, one of 56 numbers; a level without one stays still.
  face(level, pose, program) {
    if (!pose.face) return;
    const gl = this.gl, { face } = this.content.get(level), rows = face ? face.facts.rows : 1;
    const kept = this.kept(`face ${level}`, () => ({ texture: gl.createTexture(), shown: "" }));
    gl.activeTexture(gl.TEXTURE0 + FACE_UNIT);
    gl.bindTexture(gl.TEXTURE_2D, kept.texture);
    const wanted = face ? pose.face.join() : "still";
    if (kept.shown !== wanted) {
      kept.shown = wanted;
      const texels = face ? face.texels({ weights: pose.face.subarray(0, 52), gaze: pose.face.subarray(52) })
        : new Float32Array(4 * FACE_WIDTH);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, FACE_WIDTH, rows, 0, gl.RGBA, gl.FLOAT, texels);
      for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER])
        gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    }
    if (!face) gl.vertexAttribI4ui(gl.getAttribLocation(program, "face_slot"), 0, 0, 0, 0);
  }

  // An image with depth, of several samples a pixel or one.
  target(width, height, samples) {
    const key = `${width} ${height} ${samples}`;
    if (!this.targets.has(key)) {
      const gl = this.gl, framebuffer = gl.createFramebuffer(), attached = [];
      gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
      for (const [point, format] of [[gl.COLOR_ATTACHMENT0, gl.RGBA8], [gl.DEPTH_ATTACHMENT, gl.DEPTH_COMPONENT24]]) {
        const buffer = gl.createRenderbuffer();
        gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
        gl.renderbufferStorageMultisample(gl.RENDERBUFFER, samples, format, width, height);
        gl.framebufferRenderbuffer(gl.FRAMEBUFFER, point, gl.RENDERBUFFER, buffer);
        attached.push(buffer);
      }
      this.targets.set(key, { framebuffer, attached });
    }
    return this.targets.get(key).framebuffer;
  }

  // One frame of width x height pixels into a framebuffer of its own, which is returned. rung: {view, level, halvings, joints};
  // camera: {target, distance, azimuth, elevation, fov}; background: three numbers of [0, 1]. The level is loaded.
  frame(pose, camera, rung, width, height, background, samples = 0) {
    const gl = this.gl, { level = 0, halvings = 0, joints = 4 } = rung;
    // a window that is dragged larger leaves no pile of them; here, where nobody holds one
    if (this.targets.size > 12) {
      for (const { framebuffer, attached } of this.targets.values()) {
        gl.deleteFramebuffer(framebuffer);
        attached.forEach((buffer) => gl.deleteRenderbuffer(buffer));
      }
      this.targets.clear();
    }
    // a level without features has the paper's colors
    const view = this.avatar.levels[level].features ? rung.view : "off";
    const into = this.target(width, height, samples), array = this.array(level, view, joints), program = this.program(view, joints);
    const bones = posedBones(this.skeleton, pose, viewFromWorld(camera));
    const planes = clipPlanes(bones.centers, this.avatar.levels[level].radii);
    gl.bindFramebuffer(gl.FRAMEBUFFER, into);
    gl.viewport(0, 0, width, height);
    gl.clearColor(...background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    if (!planes) return into;
    const constants = new Float32Array(20);
    constants.set(clipFromView(camera.fov, width, height, planes));
    constants[16] = 1;
    [constants, bones.palette, bones.turns].forEach((data, k) => {
      gl.bindBuffer(gl.UNIFORM_BUFFER, this.buffers[k]);
      gl.bufferSubData(gl.UNIFORM_BUFFER, 0, data);
    });
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    this.textures(level, halvings);
    this.face(level, pose, program);
    gl.useProgram(program);
    gl.bindVertexArray(array);
    gl.drawElements(gl.TRIANGLES, 3 * this.avatar.levels[level].triangles, gl.UNSIGNED_INT, 0);
    gl.bindVertexArray(null);
    return into;
  }

  // As many pixels as the canvas takes on the screen, or so many; whether these are others than before, and so all black.
  fit(size = null) {
    const { canvas } = this, box = canvas.getBoundingClientRect();
    const [width, height] = size || drawnSize(Math.min(window.devicePixelRatio || 1, 2), box.width, box.height);
    if (canvas.width === width && canvas.height === height) return false;
    [canvas.width, canvas.height] = [width, height];
    return true;
  }

  // A frame on the canvas; the framebuffer that holds it with one sample a pixel, and its size.
  paint(pose, camera, rung, background, samples = 0) {
    const [width, height] = drawnSize(rung.share, this.canvas.width, this.canvas.height), size = [width, height];
    let into = this.frame(pose, camera, rung, width, height, background, samples);
    if (samples) {
      const several = into;
      into = this.target(width, height, 0);
      this.copy(several, into, size, size, this.gl.NEAREST);
    }
    this.show(into, width, height);
    return { into, width, height };
  }

  // A frame of one sample a pixel on the canvas, enlarged to it where it is smaller.
  show(framebuffer, width, height) {
    const gl = this.gl, { width: across, height: down } = this.canvas;
    // a linear copy takes the mean of two by two pixels and no more
    while (width > 2 * across && height > 2 * down) {
      const size = [Math.round(width / 2), Math.round(height / 2)], half = this.target(...size, 0);
      this.copy(framebuffer, half, [width, height], size, gl.LINEAR);
      [framebuffer, width, height] = [half, ...size];
    }
    const filter = width === across && height === down ? gl.NEAREST : gl.LINEAR;
    this.copy(framebuffer, null, [width, height], [across, down], filter);
  }

  copy(from, into, source, target, filter) {
    const gl = this.gl;
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, from);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, into);
    gl.blitFramebuffer(0, 0, ...source, 0, 0, ...target, gl.COLOR_BUFFER_BIT, filter);
  }

  // RGBA of a frame without samples, rows from the bottom.
  pixels(framebuffer, width, height) {
    const gl = this.gl, out = new Uint8Array(4 * width * height);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, framebuffer);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, out);
    return out;
  }

  // Until everything asked for is drawn: a pixel of the frame is read back. Browsers give no better clock.
  finish(framebuffer) {
    const gl = this.gl;
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, framebuffer);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  }

  // Milliseconds of a frame of a picture: the median of groups of frames that each end when the last is drawn. poses turn
  // by turn.
  measure(poses, camera, rung, picture, { groups, atLeast }) {
    const size = drawnSize(rung.share, ...picture), black = [0, 0, 0];
    const draw = (k) => this.frame(poses[k % poses.length], camera, rung, ...size, black);
    this.finish(draw(0));
    this.finish(draw(1));
    let count = 1, times = [];
    while (times.length < groups) {
      const began = performance.now();
      let into = null;
      for (let k = 0; k < count; k++) into = draw(k);
      this.finish(into);
      const took = performance.now() - began;
      // the clock of a browser is coarse: groups long enough to be told by it
      if (took < atLeast && count < 512) count *= 2;
      else times.push(took / count);
    }
    times.sort((a, b) => a - b);
    return times[times.length >> 1];
  }
}
