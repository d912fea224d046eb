// The numbers of the page: see pack.py.

async function inflated(id) {
  const text = atob(document.getElementById(id).textContent.trim());
  const bytes = Uint8Array.from(text, (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

/** The text with every array reference resolved. */
async function flightData() {
  const buffer = await inflated("data");
  const size = new DataView(buffer).getUint32(0, true);
  const text = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size)));
  const floats = new Float32Array(buffer, 4 + size);
  const array = ([offset, length]) => floats.subarray(offset, offset + length);
  if (text.space) {
    for (const key of ["t", "poses", "path"]) text.space[key] = array(text.space[key]);
    for (const uav of text.space.uavs) if (uav.places) uav.places = array(uav.places);
  }
  for (const chart of text.charts) {
    for (const curve of chart.curves) {
      curve.t = array(curve.t);
      curve.values = array(curve.values);
    }
  }
  return text;
}

/** Index of the last entry of the ascending `t` that is not above `now`; 0 before the first. */
function indexAt(t, now) {
  let low = 0;
  let high = t.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (t[middle] <= now) low = middle;
    else high = middle - 1;
  }
  return low;
}

/** The value of a curve at a time, linear in between. */
function valueAt(curve, now) {
  const k = indexAt(curve.t, now);
  if (k + 1 >= curve.t.length || now <= curve.t[0]) return curve.values[k];
  const part = (now - curve.t[k]) / (curve.t[k + 1] - curve.t[k]);
  return curve.values[k] + part * (curve.values[k + 1] - curve.values[k]);
}

/** The flight at one instant: place, attitude, speed of every UAV. */
class Motion {
  constructor(space) {
    this.space = space;
    this.count = space.uavs.length;
    this.begin = space.t[0];
    this.end = space.t[space.t.length - 1];
  }

  place(frame, uav) {
    const at = (frame * this.count + uav) * 7;
    return this.space.poses.subarray(at, at + 3);
  }

  pose(uav, now) {
    const { t, poses } = this.space;
    const k = Math.min(indexAt(t, now), t.length - 2);
    const part = Math.min(Math.max((now - t[k]) / (t[k + 1] - t[k]), 0), 1);
    const a = (k * this.count + uav) * 7;
    const b = a + this.count * 7;
    const mixed = new Float64Array(7);
    for (let i = 0; i < 7; i++) mixed[i] = poses[a + i] + part * (poses[b + i] - poses[a + i]);
    const size = Math.hypot(mixed[3], mixed[4], mixed[5], mixed[6]) || 1;
    for (let i = 3; i < 7; i++) mixed[i] /= size;
    return mixed;
  }

  /** Where a UAV is to be beside the leader; null for the leader. */
  beside(uav, now) {
    const { offset, places } = this.space.uavs[uav];
    if (!places) return offset;
    const a = 3 * indexAt(this.space.t, now);
    return [places[a], places[a + 1], places[a + 2]];
  }

  /** Where an obstacle is. */
  obstacle(one, now) {
    if (!one.way) return one.place;
    const { t, places } = one.way;
    const k = Math.min(indexAt(t, now), t.length - 2);
    const part = Math.min(Math.max((now - t[k]) / (t[k + 1] - t[k]), 0), 1);
    return places[k].map((from, i) => from + part * (places[k + 1][i] - from));
  }

  speed(uav, now) {
    const { t } = this.space;
    const k = Math.min(indexAt(t, now), t.length - 2);
    const a = this.place(k, uav);
    const b = this.place(k + 1, uav);
    return Math.hypot(b[0] - a[0], b[1] - a[1], b[2] - a[2]) / (t[k + 1] - t[k]);
  }
}

/** Distance of a place from an obstacle at `centre`: from the centre of a sphere, from the surface of all others. */
function distanceTo(one, centre, place) {
  const away = [0, 1, 2].map((i) => place[i] - centre[i]);
  if (one.kind === "sphere") return Math.hypot(...away);
  const local = [0, 1, 2].map((i) => one.axes[i] * away[0] + one.axes[3 + i] * away[1] + one.axes[6 + i] * away[2]);
  if (one.kind === "half_space") return local[2];
  if (one.kind === "plane") return Math.abs(local[2]);
  const beyond = one.kind === "cylinder"
    ? [Math.hypot(local[0], local[1]) - one.half[0], Math.abs(local[2]) - one.half[2]]
    : local.map((x, i) => Math.abs(x) - one.half[i]);
  return Math.hypot(...beyond.map((x) => Math.max(x, 0))) + Math.min(Math.max(...beyond), 0);
}

const inside = (spans, now) => spans.some(([begin, end]) => begin <= now && now <= end);
