// A camera that turns around a point, and what the pointer and the keys do to it.

class Camera {
  /** `points`: what the view shows whole at first. */
  constructor(low, high, points) {
    const centre = low.map((one, i) => (one + high[i]) / 2);
    const radius = Math.max(Math.hypot(...low.map((one, i) => high[i] - one)) / 2, 3);
    this.home = { azimuth: -2.15, elevation: 0.42, centre, radius };
    this.points = points;
    this.fov = 0.7;
    this.reset();
  }

  reset(azimuth = this.home.azimuth, elevation = this.home.elevation) {
    this.azimuth = azimuth;
    this.elevation = elevation;
    this.target = [...this.home.centre];
    this.distance = this.home.radius / Math.sin(this.fov / 2);
    this.unfit = true; // until the size of the picture is known
  }

  /** Move so that all points just fill the picture. */
  fit(width, height) {
    this.unfit = false;
    for (let round = 0; round < 8; round++) {
      this.aim(width, height);
      const seen = this.points.map((one) => this.project(one));
      const [xs, ys] = [seen.map((one) => one[0]), seen.map((one) => one[1])];
      const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
      this.pan((width - x0 - x1) / 2, (height - y0 - y1) / 2);
      this.zoom(Math.max((x1 - x0) / (0.88 * width), (y1 - y0) / (0.84 * height)));
    }
  }

  turn(dx, dy) {
    this.azimuth -= dx;
    this.elevation = Math.min(Math.max(this.elevation + dy, -0.2), Math.PI / 2 - 1e-3);
  }

  zoom(factor) {
    this.distance = Math.min(Math.max(this.distance * factor, 1), this.home.radius * 20);
  }

  /** Move the target by pixels. */
  pan(dx, dy) {
    const metres = this.distance / this.focal;
    for (let i = 0; i < 3; i++) this.target[i] += metres * (dy * this.up[i] - dx * this.right[i]);
  }

  /** Prepare `project` for a picture of this size. */
  aim(width, height) {
    const [ca, sa] = [Math.cos(this.azimuth), Math.sin(this.azimuth)];
    const [ce, se] = [Math.cos(this.elevation), Math.sin(this.elevation)];
    this.middle = [width / 2, height / 2];
    this.focal = Math.min(width, height) / 2 / Math.tan(this.fov / 2);
    this.forward = [-ce * ca, -ce * sa, -se];
    this.right = [-sa, ca, 0];
    this.up = [-se * ca, -se * sa, ce];
    this.eye = this.target.map((one, i) => one - this.distance * this.forward[i]);
  }

  /** [x, y, depth, pixels per metre] of a point. */
  project(point) {
    const x = point[0] - this.eye[0];
    const y = point[1] - this.eye[1];
    const z = point[2] - this.eye[2];
    const depth = x * this.forward[0] + y * this.forward[1] + z * this.forward[2];
    const scale = this.focal / Math.max(depth, 0.05);
    const across = x * this.right[0] + y * this.right[1] + z * this.right[2];
    const above = x * this.up[0] + y * this.up[1] + z * this.up[2];
    return [this.middle[0] + across * scale, this.middle[1] - above * scale, depth, scale];
  }
}

/** Pointer, wheel and keys on `canvas`; `changed` is called after each. */
function steer(canvas, camera, changed) {
  const held = new Map();
  const gap = () => {
    const [a, b] = [...held.values()];
    return Math.hypot(a.x - b.x, a.y - b.y);
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    held.set(event.pointerId, { x: event.clientX, y: event.clientY });
    canvas.classList.add("held");
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = held.get(event.pointerId);
    if (!before) return;
    const [dx, dy] = [event.clientX - before.x, event.clientY - before.y];
    const apart = held.size === 2 ? gap() : 0;
    held.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (held.size === 2) {
      camera.zoom(apart / Math.max(gap(), 1));
      camera.pan(dx / 2, dy / 2);
    } else if (event.shiftKey || event.buttons === 2 || event.buttons === 4) camera.pan(dx, dy);
    else camera.turn(dx * 0.008, dy * 0.008);
    changed();
  });
  const release = (event) => {
    held.delete(event.pointerId);
    if (!held.size) canvas.classList.remove("held");
  };
  canvas.addEventListener("pointerup", release);
  canvas.addEventListener("pointercancel", release);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    camera.zoom(Math.exp(Math.sign(event.deltaY) * Math.min(Math.abs(event.deltaY), 100) * 0.0015));
    changed();
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const moves = {
      ArrowLeft: () => camera.turn(-0.08, 0), ArrowRight: () => camera.turn(0.08, 0),
      ArrowUp: () => camera.turn(0, 0.08), ArrowDown: () => camera.turn(0, -0.08),
      "+": () => camera.zoom(0.9), "=": () => camera.zoom(0.9), "-": () => camera.zoom(1 / 0.9),
    };
    if (!moves[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    moves[event.key]();
    event.preventDefault();
    event.stopPropagation();
    changed();
  });
}
