// A camera round a point, turned and brought nearer by hand. One finger or button turns, two fingers, shift or the right
// button shift it, wheel and pinch go nearer.

const STEEPEST = 1.5;
const limited = (value, low, high) => Math.min(Math.max(value, low), high);

class Orbit {
  // home: {target, distance, person, azimuth, elevation, fov}, target and distance fitted to a square picture of all that
  // is done; `person` has those of who stays in place, and `narrow`, the distance of a picture twice as high as wide.
  // changed: called after every move; walked: how far the person is from where the motion begins
  constructor(canvas, home, changed, walked = () => [0, 0, 0]) {
    Object.assign(this, { canvas, home, changed, walked, held: new Map() });
    this.own = { ...home };
    this.fitted = true;
    this.listen();
  }

  // Until the reader chooses, a picture higher than wide follows the person: all of a walk is far away on a phone.
  get camera() {
    const { own, canvas, home: { person } } = this, ratio = canvas.height / canvas.width;
    if (!this.fitted || ratio <= 1) return own;
    const [x, , z] = this.walked(), [a, b, c] = person.target;
    return { ...own, target: [a + x, b, c + z], distance: Math.max(person.distance, (person.narrow * ratio) / 2) };
  }

  reset() {
    this.own = { ...this.home };
    this.fitted = true;
    this.changed();
  }

  move(change) {
    this.own = { ...this.camera, ...change };
    this.fitted = false;
    this.changed();
  }

  // Half a degree a pixel.
  turn(dx, dy) {
    const { azimuth, elevation } = this.camera, step = Math.PI / 360;
    this.move({ azimuth: azimuth - step * dx, elevation: limited(elevation + step * dy, -STEEPEST, STEEPEST) });
  }

  // The target follows the pointer.
  shift(dx, dy) {
    const camera = this.camera, seen = viewFromWorld(camera);
    const metres = (2 * camera.distance * Math.tan(camera.fov / 2)) / this.canvas.clientHeight;
    this.move({ target: camera.target.map((value, k) => value - metres * (dx * seen[k] - dy * seen[4 + k])) });
  }

  approach(factor) {
    this.move({ distance: limited(this.camera.distance * factor, 0.05, 1000) });
  }

  listen() {
    const { canvas, held } = this;
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      held.set(event.pointerId, [event.clientX, event.clientY]);
    });
    canvas.addEventListener("pointermove", (event) => this.dragged(event));
    for (const end of ["pointerup", "pointercancel"])
      canvas.addEventListener(end, (event) => held.delete(event.pointerId));
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.approach(0.999 ** -limited(event.deltaY * (event.deltaMode ? 30 : 1), -300, 300));
    }, { passive: false });
    canvas.addEventListener("dblclick", () => this.reset());
  }

  dragged(event) {
    const { held } = this, before = held.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY], dx = now[0] - before[0], dy = now[1] - before[1];
    if (held.size === 1) {
      if (event.buttons & 6 || event.shiftKey) this.shift(dx, dy);
      else this.turn(dx, dy);
    } else {
      const other = [...held].find(([id]) => id !== event.pointerId)[1];
      const far = (point) => Math.hypot(point[0] - other[0], point[1] - other[1]);
      if (far(now) > 1) this.approach(far(before) / far(now));
      this.shift(dx / 2, dy / 2);
    }
    held.set(event.pointerId, now);
  }
}
