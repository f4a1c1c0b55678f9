// Where an avatar's bones are before a camera, in double precision; mirrors player/draw/posing.py and avatar/camera.py.
// Rigid transforms are 12 numbers, rows of [R | t].

function product(a, b) {
  const out = new Float64Array(12);
  for (let r = 0; r < 12; r += 4)
    for (let c = 0; c < 4; c++)
      out[r + c] = a[r] * b[c] + a[r + 1] * b[4 + c] + a[r + 2] * b[8 + c] + (c === 3 ? a[r + 3] : 0);
  return out;
}

function rigid(q, at, place) {
  const length = Math.hypot(q[at], q[at + 1], q[at + 2], q[at + 3]);
  const [x, y, z, w] = [q[at] / length, q[at + 1] / length, q[at + 2] / length, q[at + 3] / length];
  return Float64Array.of(
    1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), place[0],
    2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), place[1],
    2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), place[2]);
}

// Unit quaternion xyzw of a rotation (Shepperd 1978).
function quaternion(m) {
  const [xx, xy, xz, , yx, yy, yz, , zx, zy, zz] = m, trace = xx + yy + zz;
  let q;
  if (trace >= Math.max(xx, yy, zz)) q = [zy - yz, xz - zx, yx - xy, 1 + trace];
  else if (xx >= yy && xx >= zz) q = [1 + xx - yy - zz, xy + yx, xz + zx, zy - yz];
  else if (yy >= zz) q = [xy + yx, 1 + yy - xx - zz, yz + zy, xz - zx];
  else q = [xz + zx, yz + zy, 1 + zz - xx - yy, yx - xy];
  const length = Math.hypot(...q);
  return q.map((value) => value / length);
}

// Values of a moment of the motion, so many a frame, between two frames where it falls there.
function mixed(motion, values, size, frame) {
  const i = limited(Math.floor(frame + 1e-6), 0, motion.frames - 1);
  const t = i + 1 < motion.frames ? limited(frame - i, 0, 1) : 0, s = t < 1e-6 ? 0 : t;
  return Float64Array.from({ length: size }, (_, k) =>
    (1 - s) * values[size * i + k] + (s ? s * values[size * (i + 1) + k] : 0));
}

// Where the pelvis is, metres.
function placeAt(motion, frame) {
  return mixed(motion, motion.places, 3, frame);
}

// The pose of a moment of the motion.
function poseAt(motion, frame) {
  const face = motion.faces && mixed(motion, motion.faces, 56, frame);
  return { q: mixed(motion, motion.q, 208, frame), place: placeAt(motion, frame), face };
}

// Bones as the shaders take them: rows of view_from_canonical, its quaternions; joints in view space.
function posedBones(skeleton, pose, viewFromWorld) {
  const palette = new Float32Array(52 * 12), turns = new Float32Array(52 * 4), centers = new Float64Array(156);
  const joints = [];
  for (let k = 0; k < 52; k++) {
    const parent = skeleton.parents[k];
    const local = rigid(pose.q, 4 * k, parent < 0 ? pose.place : skeleton.offsets[k]);
    joints.push(product(parent < 0 ? viewFromWorld : joints[parent], local));
    const bone = product(joints[k], skeleton.jointFromCanonical[k]);
    palette.set(bone, 12 * k);
    turns.set(quaternion(bone), 4 * k);
    for (let c = 0; c < 3; c++) centers[3 * k + c] = joints[k][4 * c + 3];
  }
  return { palette, turns, centers };
}

// Near and far, metres, that hold what the bones move; null: all of it is behind the eye.
function clipPlanes(centers, radii) {
  let near = Infinity, far = -Infinity;
  radii.forEach((radius, k) => {
    if (radius < 0) return;
    near = Math.min(near, -centers[3 * k + 2] - radius);
    far = Math.max(far, radius - centers[3 * k + 2]);
  });
  if (!(far > 0)) return null;
  near = Math.max(0.999 * near, 1e-3 * far);
  return [near, Math.max(1.001 * far, 1.01 * near)];
}

// A camera on a sphere round its target: azimuth 0 looks at the chest, growing towards +x; radians, metres.
function viewFromWorld({ target, distance, azimuth, elevation }) {
  const flat = Math.cos(elevation);
  const away = [Math.sin(azimuth) * flat, Math.sin(elevation), Math.cos(azimuth) * flat];
  const right = [Math.cos(azimuth), 0, -Math.sin(azimuth)];
  const up = [away[1] * right[2] - away[2] * right[1], away[2] * right[0] - away[0] * right[2],
    away[0] * right[1] - away[1] * right[0]];
  const eye = target.map((value, k) => value + distance * away[k]);
  const row = (axis) => [...axis, -(axis[0] * eye[0] + axis[1] * eye[1] + axis[2] * eye[2])];
  return Float64Array.of(...row(right), ...row(up), ...row(away));
}

// By columns, as GL takes it; fov is vertical, radians.
function clipFromView(fov, width, height, [near, far]) {
  const slope = Math.tan(fov / 2), out = new Float32Array(16);
  out[0] = height / (width * slope);
  out[5] = 1 / slope;
  out[10] = -(far + near) / (far - near);
  out[11] = -1;
  out[14] = (-2 * far * near) / (far - near);
  return out;
}
