// The bytes of the page as arrays and images. Mirrors player/web/packing.py.

// Bytes of a <script type="text/plain" id=NAME> in base64; the text is let go.
function pageBytes(name) {
  const element = document.getElementById(name), text = element.textContent.trim();
  element.remove();
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const letters = atob(text), bytes = new Uint8Array(letters.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = letters.charCodeAt(i);
  return bytes;
}

async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Sums of differences, modulo what `width` bytes hold: component by component, all lowest bytes first.
function summed(bytes, start, count, components, width) {
  const total = count * components, out = new Uint32Array(total), most = 2 ** (8 * width) - 1;
  const part = (at, k) => (k < width ? bytes[at + k * total] << (8 * k) : 0);
  for (let c = 0, at = start; c < components; c++) {
    let value = 0;
    for (let i = 0; i < count; i++, at++) {
      const z = bytes[at] | part(at, 1) | part(at, 2) | part(at, 3);
      value = (value + ((z >>> 1) ^ -(z & 1))) & most;
      out[i * components + c] = value;
    }
  }
  return out;
}

function half(bits) {
  const sign = bits & 0x8000 ? -1 : 1, exponent = (bits >> 10) & 31, fraction = bits & 1023;
  return sign * (exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : 2 ** -14 * (fraction / 1024));
}

// An array by its facts, and where the next one begins.
function unpackedArray(bytes, start, how, vertices, Array_ = Float32Array) {
  const { kind, components } = how, total = vertices * components;
  if (kind === "indices") return [summed(bytes, start, how.count, 1, 4), start + 4 * how.count];
  if (kind === "bytes") {
    const out = new Uint8Array(total);
    for (let c = 0, at = start; c < components; c++)
      for (let i = 0; i < vertices; i++, at++) out[i * components + c] = bytes[at];
    return [out, start + total];
  }
  const steps = summed(bytes, start, vertices, components, how.bytes), out = new Array_(total);
  if (kind === "half") for (let i = 0; i < total; i++) out[i] = half(steps[i]);
  else for (let i = 0, c = 0; i < total; i++, c = (c + 1) % components) out[i] = how.offset[c] + how.scale[c] * steps[i];
  return [out, start + how.bytes * total];
}

// The arrays of a level's mesh by name.
async function unpackedMesh(facts, bytes) {
  const data = await inflated(bytes), arrays = {};
  let at = 0;
  for (const how of facts.arrays) [arrays[how.name], at] = unpackedArray(data, at, how, facts.vertices);
  return arrays;
}

// Four planes of bytes from differences to Paeth's guess, as an image of four channels.
async function unpackedFeatures({ size: [width, height] }, bytes) {
  const data = await inflated(bytes), image = new Uint8Array(4 * width * height), row = 4 * width;
  for (let plane = 0, from = 0; plane < 4; plane++)
    for (let y = 0; y < height; y++) {
      let left = 0, corner = 0;
      for (let x = 0, at = y * row + plane; x < width; x++, at += 4, from++) {
        const above = y ? image[at - row] : 0;
        const guess = left + above - corner;
        const a = Math.abs(guess - left), b = Math.abs(guess - above), c = Math.abs(guess - corner);
        left = image[at] = data[from] + (a <= b && a <= c ? left : b <= c ? above : corner);
        left &= 255;
        corner = above;
      }
    }
  return image;
}

// Bytes of the picture as they were stored: browsers else turn them into the screen's colors.
function unpackedColor(bytes) {
  return createImageBitmap(new Blob([bytes], { type: "image/webp" }),
    { premultiplyAlpha: "none", colorSpaceConversion: "none", imageOrientation: "none" });
}

// What moves a level's face; null: nothing does.
async function unpackedFace(facts, mesh, name) {
  if (!facts) return null;
  return new Face(facts, mesh, unpackedArray(await inflated(pageBytes(name)), 0, facts.shapes, facts.moving)[0]);
}

// Quaternions (208 numbers a frame) and places (3) of a motion, and where its face moves its weights and gaze (52 and 4).
async function unpackedMotion({ frames, rate, turns, root, face }) {
  const data = await inflated(pageBytes("motion"));
  const [q, next] = unpackedArray(data, 0, turns, frames, Float64Array);
  const [places, last] = unpackedArray(data, next, root, frames, Float64Array);
  const faces = face ? unpackedArray(data, last, face, frames, Float64Array)[0] : null;
  return { frames, rate, q, places, faces };
}
