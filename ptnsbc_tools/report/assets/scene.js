// The flight in space on a plain 2-D canvas: no WebGL, so it runs on any machine, and smoothly.

const RING = Array.from({ length: 49 }, (_, k) => {
  const angle = (k / 48) * 2 * Math.PI;
  return [Math.cos(angle), Math.sin(angle)];
});
const NEAR = 0.2; // [m] in front of the eye
const FIT_POINTS = 150; // instants that the view at the beginning shows whole
const LEAST_ARM = 14; // [pixels]
const NAME_FONT = "600 12px system-ui, sans-serif";
const NAME_HALF = 11; // of the height of a name with its line [pixels]
const COVERED_NAME = 10; // cost of a square pixel: a name has to be readable,
const COVERED_UAV = 1; // a UAV may be covered a little
// Where a name may stand: right, down, and pixels away from its UAV; the nearest first.
const NAME_PLACES = [0, 16, 32, 48, 64].flatMap((far) => [
  [0, -1], [1, -1], [-1, -1], [1, 0], [-1, 0], [1, 1], [-1, 1], [0, 1]].map((side) => [...side, far]));

class Scene {
  constructor(canvas, motion, state) {
    this.canvas = canvas;
    this.pen = canvas.getContext("2d");
    this.motion = motion;
    this.space = motion.space;
    this.state = state; // hidden, colour(), trail, follow
    this.due = false;
    this.now = motion.begin;
    this.measure();
    steer(canvas, this.camera, () => this.draw());
    this.box = canvas.getBoundingClientRect(); // asked once: in a frame it would cost a layout
    new ResizeObserver(() => {
      this.box = canvas.getBoundingClientRect();
      this.draw();
    }).observe(canvas);
  }

  /** Bounds of what flies, and the floor under it. */
  measure() {
    const low = [Infinity, Infinity, Infinity];
    const high = [-Infinity, -Infinity, -Infinity];
    const flown = [];
    const every = Math.ceil(this.space.t.length / FIT_POINTS);
    for (let k = 0; k < this.space.t.length; k += every) {
      for (let i = 0; i < this.motion.count; i++) flown.push(this.motion.place(k, i));
    }
    if (this.space.bounds) { // of a flight that goes on
      for (let k = 0; k < 8; k++) flown.push([0, 1, 2].map((i) => this.space.bounds[(k >> i) & 1][i]));
    }
    for (const point of flown) {
      for (let i = 0; i < 3; i++) {
        if (!Number.isFinite(point[i])) continue;
        low[i] = Math.min(low[i], point[i]);
        high[i] = Math.max(high[i], point[i]);
      }
    }
    for (let i = 0; i < 3; i++) if (!Number.isFinite(low[i])) [low[i], high[i]] = [-1, 1];
    this.floor = low[2] >= -0.5 && low[2] < 30 ? 0 : Math.floor(low[2]);
    const span = Math.max(high[0] - low[0], high[1] - low[1], 4);
    this.step = [1, 2, 5, 10, 20, 50, 100, 200, 500].find((one) => span / one <= 14) || 1000;
    const snap = (value, up) => (up ? Math.ceil(value / this.step) : Math.floor(value / this.step)) * this.step;
    this.ground = [snap(low[0] - 1, false), snap(low[1] - 1, false), snap(high[0] + 1, true), snap(high[1] + 1, true)];
    const seen = flown.filter((point) => Number.isFinite(point[0] + point[1] + point[2]));
    this.camera = new Camera(low, high, seen.length ? seen : [low, high]);
  }

  /** Show a time; `inFrame`: the browser is about to draw, another turn would halve the rate. */
  show(now, inFrame) {
    this.now = now;
    if (inFrame) this.paint();
    else this.draw();
  }

  draw() {
    if (this.due) return;
    this.due = true;
    requestAnimationFrame(() => {
      this.due = false;
      this.paint();
    });
  }

  paint() {
    const { canvas, pen, box } = this;
    if (!box.width) return;
    const sharp = Math.min(window.devicePixelRatio || 1, 2);
    const [width, height] = [Math.round(box.width * sharp), Math.round(box.height * sharp)];
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    pen.setTransform(sharp, 0, 0, sharp, 0, 0);
    pen.clearRect(0, 0, box.width, box.height);
    pen.lineJoin = pen.lineCap = "round";
    this.poses = this.space.uavs.map((_, i) => this.motion.pose(i, this.now));
    if (this.camera.unfit) this.camera.fit(box.width, box.height);
    if (this.state.follow) this.followLeader();
    this.camera.aim(box.width, box.height);
    this.paintFloor();
    const items = [];
    this.names = [];
    this.addObstacles(items);
    this.addTrails(items);
    this.addEdges(items);
    this.addUavs(items);
    items.sort((a, b) => b.depth - a.depth);
    for (const item of items) item.draw();
    this.paintNames(); // never behind anything
  }

  /** The names, each where it covers neither another name nor a UAV as far as there is room; those farther off with a line. */
  paintNames() {
    const { pen } = this;
    pen.font = NAME_FONT;
    this.names.sort((a, b) => a.order - b.order); // by depth they would change places
    const taken = this.names.filter(({ size }) => size)
      .map(({ x, y, size }) => [x - size, y - size, x + size, y + size, COVERED_UAV]);
    for (const one of this.names) {
      const half = pen.measureText(one.words).width / 2;
      let best = null;
      for (const [right, down, far] of one.size ? NAME_PLACES : [[0, 0, 0], ...NAME_PLACES]) {
        const x = one.x + right * (one.size + half + far);
        const y = one.y + down * (one.size + NAME_HALF + far);
        const cost = far + taken.reduce((sum, [x0, y0, x1, y1, weight]) => {
          const wide = Math.min(x + half + 2, x1) - Math.max(x - half - 2, x0);
          const high = Math.min(y + NAME_HALF, y1) - Math.max(y - NAME_HALF, y0);
          return wide > 0 && high > 0 ? sum + weight * wide * high : sum;
        }, 0);
        if (!best || cost < best.cost) best = { x, y, half, cost, far };
        if (cost <= far) break; // free, and no place after it is nearer
      }
      taken.push([best.x - half - 2, best.y - NAME_HALF, best.x + half + 2, best.y + NAME_HALF, COVERED_NAME]);
      one.place = best;
    }
    for (const one of this.names) this.lead(one);
    for (const { words, place, colour } of this.names) this.name(words, place, colour);
  }

  /** A thin line from a UAV to its name, when the name is not beside it. */
  lead({ x, y, place, colour }) {
    if (!place.far) return;
    const { pen } = this;
    pen.strokeStyle = colour || this.colour("--soft");
    pen.lineWidth = 1;
    pen.beginPath();
    pen.moveTo(x, y);
    pen.lineTo(place.x, place.y);
    pen.stroke();
  }

  followLeader() {
    const index = Math.max(this.space.uavs.findIndex((uav) => uav.leader), 0);
    const pose = this.poses[index];
    if (Number.isFinite(pose[0])) this.camera.target = [pose[0], pose[1], pose[2] - 0.5];
  }

  colour(name) {
    return this.state.style[name];
  }

  /** A line between two points in space, cut off at the eye. */
  line(a, b) {
    const [pa, pb] = [this.camera.project(a), this.camera.project(b)];
    if (pa[2] < NEAR && pb[2] < NEAR) return;
    const cut = (from, to, p, q) => {
      if (p[2] >= NEAR) return p;
      const part = (NEAR - p[2]) / (q[2] - p[2]) + 1e-6;
      return this.camera.project(from.map((one, i) => one + part * (to[i] - one)));
    };
    const [start, stop] = [cut(a, b, pa, pb), cut(b, a, pb, pa)];
    this.pen.moveTo(start[0], start[1]);
    this.pen.lineTo(stop[0], stop[1]);
  }

  /** A flat ring around a centre. */
  ring(centre, radius) {
    const { pen } = this;
    RING.forEach(([c, s], k) => {
      const [x, y] = this.camera.project([centre[0] + radius * c, centre[1] + radius * s, centre[2]]);
      if (k) pen.lineTo(x, y);
      else pen.moveTo(x, y);
    });
  }

  paintFloor() {
    const { pen, ground, step, floor } = this;
    const [x0, y0, x1, y1] = ground;
    pen.strokeStyle = this.colour("--floor");
    pen.globalAlpha = 0.55;
    pen.lineWidth = 0.8;
    pen.beginPath();
    for (let x = x0; x <= x1 + 1e-6; x += step) this.line([x, y0, floor], [x, y1, floor]);
    for (let y = y0; y <= y1 + 1e-6; y += step) this.line([x0, y, floor], [x1, y, floor]);
    pen.stroke();
    pen.globalAlpha = 1;
    pen.fillStyle = this.colour("--soft");
    pen.font = "11px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    const nearY = this.camera.eye[1] < (y0 + y1) / 2 ? y0 - step * 0.35 : y1 + step * 0.35;
    const nearX = this.camera.eye[0] < (x0 + x1) / 2 ? x0 - step * 0.35 : x1 + step * 0.35;
    const every = (x1 - x0) / step > 8 ? 2 * step : step;
    for (let x = Math.ceil(x0 / every) * every; x <= x1; x += every) this.text([x, nearY, floor], `${x}`);
    for (let y = Math.ceil(y0 / every) * every; y <= y1; y += every) this.text([nearX, y, floor], `${y}`);
    pen.font = "600 12px system-ui, sans-serif";
    const away = step * 1.1;
    const beyond = (near, low, high) => (near < low ? low - away : high + away);
    this.text([(x0 + x1) / 2 + every / 2, beyond(nearY, y0, y1), floor], "east m");
    this.text([beyond(nearX, x0, x1), (y0 + y1) / 2 + every / 2, floor], "north m");
  }

  text(point, words) {
    const [x, y, depth] = this.camera.project(point);
    if (depth > NEAR) this.pen.fillText(words, x, y);
  }

  addObstacles(items) {
    const { pen, camera } = this;
    for (const one of this.space.obstacles) {
      const place = this.motion.obstacle(one, this.now);
      if (one.kind !== "sphere") {
        this.addBody(items, one, place);
        continue;
      }
      const [x, y, depth, scale] = camera.project(place);
      if (depth < NEAR) continue;
      const below = [place[0], place[1], this.floor];
      items.push({ depth: 1e6, draw: () => this.shadow(below, one.keepOut, 0.1) });
      items.push({ depth, draw: () => {
        const radius = one.keepOut * scale;
        const ball = pen.createRadialGradient(x - radius * 0.35, y - radius * 0.4, radius * 0.1, x, y, radius);
        ball.addColorStop(0, "rgba(160, 168, 180, 0.40)");
        ball.addColorStop(1, "rgba(110, 120, 135, 0.62)");
        pen.fillStyle = ball;
        pen.beginPath();
        this.outline(place, one.keepOut);
        pen.fill();
        pen.strokeStyle = this.colour("--soft");
        pen.lineWidth = 1.2;
        pen.setLineDash([5, 4]);
        pen.stroke();
        pen.beginPath();
        this.ring(place, one.keepOut);
        pen.globalAlpha = 0.5;
        pen.stroke();
        pen.globalAlpha = 1;
        pen.setLineDash([]);
        this.label(one.name, x, y, radius);
      } });
    }
  }

  /** The name of an obstacle at a point; of one beyond the edge, on the part of it, of this radius, that is in the picture. */
  label(words, x, y, radius) {
    const { pen, camera } = this;
    pen.font = NAME_FONT;
    const away = [pen.measureText(words).width / 2 + 4, NAME_HALF];
    const seen = [x, y].map((at, i) => Math.min(Math.max(at, away[i]), 2 * camera.middle[i] - away[i]));
    const shift = Math.hypot(seen[0] - x, seen[1] - y);
    if (shift < Math.max(radius - NAME_HALF, 2 * away[0])) {
      this.names.push({ words, x: seen[0], y: seen[1], size: 0, order: -1 });
    }
  }

  /** The faces of a body that is no sphere, each a ring of points; of a surface without end as much as the floor has. */
  faces(one, centre) {
    const [a, b, c] = one.half;
    const at = (x, y, z) => [0, 1, 2].map(
      (i) => centre[i] + one.axes[3 * i] * x + one.axes[3 * i + 1] * y + one.axes[3 * i + 2] * z);
    if (one.kind === "box") {
      const side = (axis, sign) => [[1, 1], [1, -1], [-1, -1], [-1, 1]].map(([u, v]) => {
        const corner = [0, 0, 0];
        [corner[axis], corner[(axis + 1) % 3], corner[(axis + 2) % 3]] = [sign, u, v];
        return at(corner[0] * a, corner[1] * b, corner[2] * c);
      });
      return [0, 1, 2].flatMap((axis) => [side(axis, 1), side(axis, -1)]);
    }
    if (one.kind === "cylinder") {
      const [low, high] = [Math.max(-c, -40), Math.min(c, 40)];
      const rim = RING.filter((_, k) => k % 2 === 0);
      const caps = [low, high].map((z) => rim.map(([u, v]) => at(a * u, a * v, z)));
      const wall = rim.slice(1).map(([u, v], k) => [
        at(a * rim[k][0], a * rim[k][1], low), at(a * u, a * v, low),
        at(a * u, a * v, high), at(a * rim[k][0], a * rim[k][1], high)]);
      return [...caps, ...wall];
    }
    const [x0, y0, x1, y1] = this.ground;
    const middle = [(x0 + x1) / 2, (y0 + y1) / 2, centre[2]];
    const off = [0, 1, 2].reduce((sum, i) => sum + one.axes[3 * i + 2] * (middle[i] - centre[i]), 0);
    const foot = middle.map((x, i) => x - off * one.axes[3 * i + 2]);
    const reach = Math.max(x1 - x0, y1 - y0) / 2;
    return [[[1, 1], [1, -1], [-1, -1], [-1, 1]].map(([u, v]) => [0, 1, 2].map(
      (i) => foot[i] + reach * (u * one.axes[3 * i] + v * one.axes[3 * i + 1])))];
  }

  addBody(items, one, place) {
    const { pen, camera } = this;
    for (const face of this.faces(one, place)) {
      const seen = face.map((point) => camera.project(point));
      if (seen.some((point) => !(point[2] > NEAR))) continue;
      const depth = seen.reduce((sum, point) => sum + point[2], 0) / seen.length;
      items.push({ depth, draw: () => {
        pen.beginPath();
        seen.forEach(([x, y], k) => (k ? pen.lineTo(x, y) : pen.moveTo(x, y)));
        pen.closePath();
        pen.fillStyle = "rgba(130, 140, 155, 0.28)";
        pen.fill();
        pen.strokeStyle = this.colour("--soft");
        pen.lineWidth = 0.7;
        pen.globalAlpha = 0.5;
        pen.stroke();
        pen.globalAlpha = 1;
      } });
    }
    const [x, y, depth] = camera.project(place);
    if (depth < NEAR || one.kind === "half_space" || one.kind === "plane") return;
    items.push({ depth: NEAR, draw: () => this.label(one.name, x, y, 0) });
  }

  /** The edge of a ball as the eye sees it: the circle in which rays from the eye touch it. */
  outline(centre, radius) {
    const { eye } = this.camera;
    const gap = centre.map((one, i) => eye[i] - one);
    const far = Math.max(Math.hypot(...gap), radius * 1.01);
    const towards = gap.map((one) => one / far);
    const level = Math.hypot(towards[0], towards[1]) || 1e-9;
    const across = [-towards[1] / level, towards[0] / level, 0];
    const above = [-towards[2] * across[1], towards[2] * across[0], towards[0] * across[1] - towards[1] * across[0]];
    const [shift, edge] = [radius ** 2 / far, radius * Math.sqrt(1 - (radius / far) ** 2)];
    RING.forEach(([c, s], k) => {
      const [x, y] = this.camera.project(
        centre.map((one, i) => one + shift * towards[i] + edge * (c * across[i] + s * above[i])));
      if (k) this.pen.lineTo(x, y);
      else this.pen.moveTo(x, y);
    });
  }

  shadow(point, radius, strength) {
    const { pen } = this;
    pen.fillStyle = this.colour("--ink");
    pen.globalAlpha = strength;
    pen.beginPath();
    this.ring(point, radius);
    pen.fill();
    pen.globalAlpha = 1;
  }

  addTrails(items) {
    const { t, path } = this.space;
    const last = indexAt(t, this.now);
    const first = indexAt(t, this.now - this.state.trail);
    this.addPath(items, path);
    const chunk = Math.max(Math.ceil((last - first) / 120), 3);
    this.space.uavs.forEach((uav, i) => {
      if (this.state.hidden.has(uav.id)) return;
      for (let k = first; k <= last; k += chunk) {
        const points = [];
        for (let j = k; j <= Math.min(k + chunk, last); j++) points.push(this.motion.place(j, i));
        if (k + chunk > last) points.push(this.poses[i]);
        const age = last > first ? (k - first) / (last - first) : 1;
        this.addStroke(items, points, this.state.colour(uav), 0.12 + 0.75 * age * age, 2.2);
      }
    });
  }

  addStroke(items, points, colour, alpha, width) {
    const seen = points.map((one) => this.camera.project(one));
    if (seen.length < 2 || seen.some((one) => !(one[2] > NEAR) || !Number.isFinite(one[0]))) return;
    items.push({ depth: seen[0][2] + 0.05, draw: () => {
      const { pen } = this;
      pen.strokeStyle = colour;
      pen.globalAlpha = alpha;
      pen.lineWidth = width;
      pen.lineCap = "butt"; // round ends would show twice where pieces meet
      pen.beginPath();
      seen.forEach(([x, y], k) => (k ? pen.lineTo(x, y) : pen.moveTo(x, y)));
      pen.stroke();
      pen.lineCap = "round";
      pen.globalAlpha = 1;
    } });
  }

  addPath(items, path) {
    const leader = this.space.uavs.find((uav) => uav.leader);
    if (!leader || this.state.hidden.has(leader.id)) return;
    for (let k = 0; k + 6 <= path.length; k += 6) {
      const points = [path.subarray(k, k + 3), path.subarray(k + 3, k + 6)];
      this.addStroke(items, points, this.colour("--soft"), 0.55, 1.3);
    }
  }

  addEdges(items) {
    const index = new Map(this.space.uavs.map((uav, i) => [uav.id, i]));
    for (const uav of this.space.uavs) {
      if (uav.parent === null || !index.has(uav.parent)) continue;
      if (this.state.hidden.has(uav.id) || this.state.hidden.has(uav.parent)) continue;
      const child = this.poses[index.get(uav.id)];
      const parent = this.poses[index.get(uav.parent)];
      const [a, b] = [this.camera.project(parent), this.camera.project(child)];
      if (!(a[2] > NEAR && b[2] > NEAR)) continue;
      items.push({ depth: (a[2] + b[2]) / 2, draw: () => this.edge(a, b) });
    }
  }

  /** From the parent to the child, with an arrow head halfway. */
  edge(a, b) {
    const { pen } = this;
    const length = Math.hypot(b[0] - a[0], b[1] - a[1]);
    pen.strokeStyle = pen.fillStyle = this.colour("--ink");
    pen.globalAlpha = 0.55;
    pen.lineWidth = 1.4;
    pen.beginPath();
    pen.moveTo(a[0], a[1]);
    pen.lineTo(b[0], b[1]);
    pen.stroke();
    if (length > 24) {
      const [ux, uy] = [(b[0] - a[0]) / length, (b[1] - a[1]) / length];
      const [x, y] = [(a[0] + b[0]) / 2 + 5 * ux, (a[1] + b[1]) / 2 + 5 * uy];
      pen.beginPath();
      pen.moveTo(x, y);
      pen.lineTo(x - 8 * ux - 4 * uy, y - 8 * uy + 4 * ux);
      pen.lineTo(x - 8 * ux + 4 * uy, y - 8 * uy - 4 * ux);
      pen.fill();
    }
    pen.globalAlpha = 1;
  }

  addUavs(items) {
    const leaderAt = this.space.uavs.findIndex((uav) => uav.leader);
    this.space.uavs.forEach((uav, i) => {
      const pose = this.poses[i];
      if (this.state.hidden.has(uav.id) || !Number.isFinite(pose[0] + pose[1] + pose[2])) return;
      const seen = this.camera.project(pose);
      if (seen[2] < NEAR) return;
      const below = [pose[0], pose[1], this.floor];
      items.push({ depth: 1e6, draw: () => this.stem(pose, below) });
      items.push({ depth: seen[2], draw: () => this.craft(uav, pose, seen) });
      const beside = this.motion.beside(i, this.now);
      if (beside && leaderAt >= 0) {
        const goal = beside.map((one, k) => one + this.poses[leaderAt][k]);
        this.addGoal(items, goal, this.state.colour(uav));
      }
    });
  }

  addGoal(items, goal, colour) {
    const [x, y, depth] = this.camera.project(goal);
    if (!(depth > NEAR)) return;
    items.push({ depth: depth + 0.02, draw: () => {
      const { pen } = this;
      pen.strokeStyle = colour;
      pen.lineWidth = 1.5;
      pen.globalAlpha = 0.8;
      pen.beginPath();
      pen.arc(x, y, 9, 0, 2 * Math.PI);
      pen.stroke();
      pen.globalAlpha = 1;
    } });
  }

  stem(pose, below) {
    const { pen } = this;
    this.shadow(below, 0.22, 0.22);
    pen.strokeStyle = this.colour("--soft");
    pen.globalAlpha = 0.35;
    pen.lineWidth = 1;
    pen.setLineDash([2, 4]);
    pen.beginPath();
    this.line(pose, below);
    pen.stroke();
    pen.setLineDash([]);
    pen.globalAlpha = 1;
  }

  /** Arms and rotors in the attitude that was recorded; never smaller than the eye can see. */
  craft(uav, pose, [x, y, , scale]) {
    const { pen } = this;
    const arm = Math.max(0.2, LEAST_ARM / scale);
    const turned = rotation(pose);
    const at = (forward, left) => this.camera.project([0, 1, 2].map(
      (i) => pose[i] + arm * (forward * turned[3 * i] + left * turned[3 * i + 1])));
    const colour = this.state.colour(uav);
    pen.strokeStyle = this.colour("--ink");
    pen.lineWidth = 1.6;
    pen.beginPath();
    for (const [f, l] of [[0.72, 0.72], [0.72, -0.72]]) {
      const [a, b] = [at(f, l), at(-f, -l)];
      pen.moveTo(a[0], a[1]);
      pen.lineTo(b[0], b[1]);
    }
    pen.stroke();
    pen.fillStyle = colour;
    pen.lineWidth = 1;
    for (const [f, l] of [[0.72, 0.72], [0.72, -0.72], [-0.72, 0.72], [-0.72, -0.72]]) {
      pen.beginPath();
      for (const [c, s] of RING) {
        const p = at(f + 0.5 * c, l + 0.5 * s);
        pen.lineTo(p[0], p[1]);
      }
      pen.globalAlpha = 0.72;
      pen.fill();
      pen.globalAlpha = 1;
      pen.stroke();
    }
    this.halo(uav, x, y, arm * scale);
    this.names.push({ words: uav.leader ? `${uav.id} leader` : `${uav.id}`, order: uav.id, x, y, size: arm * scale, colour });
  }

  halo(uav, x, y, size) {
    const stuck = inside(uav.deadlocks, this.now);
    if (!stuck && !inside(uav.avoiding, this.now)) return;
    const { pen } = this;
    pen.strokeStyle = this.colour(stuck ? "--missed" : "--halo");
    pen.lineWidth = 2;
    pen.beginPath();
    pen.arc(x, y, size + 6, 0, 2 * Math.PI);
    pen.stroke();
  }

  name(words, { x, y, half }, colour) {
    const { pen } = this;
    pen.font = NAME_FONT;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.lineWidth = 3.5;
    pen.strokeStyle = this.colour("--sky");
    pen.strokeText(words, x, y);
    pen.fillStyle = this.colour("--ink");
    pen.fillText(words, x, y);
    if (!colour) return;
    pen.fillStyle = colour;
    pen.fillRect(x - half, y + 7, 2 * half, 2);
  }
}

/** Rotation matrix, row by row, of the quaternion in a pose. */
function rotation([, , , x, y, z, w]) {
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
    2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
    2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
  ];
}
