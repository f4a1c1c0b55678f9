// A face that moves: its shapes blended and its eyes turned, as texels for shaders/face.glsl. Mirrors player/draw/face.py.

const FACE_WIDTH = 64, FACE_UNIT = 7, CLEARANCE = 3e-4, CROSSED = (25 * Math.PI) / 180;

class Face {
  // facts: moving, rows, balls, lids and eyes of a level; shapes: 52 times 3 numbers of each moving vertex
  constructor(facts, mesh, shapes) {
    Object.assign(this, { facts, shapes });
    // where each slot's vertex rests
    this.rest = new Float64Array(3 * FACE_WIDTH * facts.rows);
    mesh.face_slot.forEach((slot, i) => {
      for (let c = 0; c < 3; c++) this.rest[3 * slot + c] = mesh.position[3 * i + c];
    });
  }

  texels({ weights, gaze }) {
    const { facts, rest, shapes } = this, out = new Float32Array(4 * FACE_WIDTH * facts.rows);
    for (let shape = 0; shape < 52; shape++) {
      // the first 14 shapes are of the eyes, 7 each, its blink first: less by what that closes (avatar/gaze.py, with_blinks)
      const closed = shape < 14 && shape % 7 ? limited(weights[shape < 7 ? 0 : 7], 0, 1) : 0;
      const weight = limited(weights[shape], 0, 1) * (1 - closed);
      if (weight)
        for (let i = 0, at = 3 * shape; i < facts.moving; i++, at += 156)
          for (let c = 0; c < 3; c++) out[4 * (i + 1) + c] += weight * shapes[at + c];
    }
    const yaw = [gaze[0], gaze[2]].map((value) => limited(value, ...facts.aside));
    const beyond = Math.max((yaw[1] - yaw[0]) / 2 - CROSSED, 0);
    facts.eyes.forEach(({ center, radius }, eye) => {
      const from = (slot) => center.map((value, c) => rest[3 * slot + c] - value);
      const R = eyeTurn(yaw[eye] + (eye ? -beyond : beyond), limited(gaze[2 * eye + 1], ...facts.upwards));
      const [first, count] = facts.balls[eye];
      for (let slot = first; slot < first + count; slot++) {
        const p = from(slot);
        for (let c = 0; c < 3; c++)
          out[4 * slot + c] = R[c][0] * p[0] + R[c][1] * p[1] + R[c][2] * p[2] - p[c];
        out[4 * slot + 3] = 1 / radius;
      }
      for (const slot of facts.lids[eye]) {
        const p = from(slot), there = p.map((value, c) => value + out[4 * slot + c]);
        const far = Math.hypot(...there), least = Math.min(Math.hypot(...p), radius + CLEARANCE);
        if (far < least) there.forEach((value, c) => { out[4 * slot + c] += value * (least / Math.max(far, 1e-9) - 1); });
      }
    });
    return out;
  }
}

// R_y(yaw) R_x(-pitch), rows.
function eyeTurn(yaw, pitch) {
  const [cy, sy, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
  return [[cy, -sy * sp, sy * cp], [0, cp, sp], [-sy, -cy * sp, cy * cp]];
}
