// The live view: the scene and the figure of the report, fed over a socket.

const AGAIN_MS = [500, 1000, 2000, 4000]; // until the next attempt to connect
const REFRESH_MS = 500; // of the figure
const ORDERS = {
  hold: "All UAVs hold where they are. Hold?",
  land: "The leader ends the formation, and all UAVs land. End flight?",
  stop: "Every vehicle lands where it is, as by ptnsbc stop. LAND ALL?",
  motors: "All motors stop at once, in the air too. VEHICLES FALL. As by ptnsbc stop --kill. STOP ALL MOTORS?",
};

/** The flight so far: like Motion, and it grows. */
class LiveMotion extends Motion {
  constructor(space, starts) {
    // Two frames before the epoch: the starts, until the first real one.
    const pose = starts.flatMap((place) => [...place, 0, 0, 0, 1]);
    super({ ...space, t: [-0.2, -0.1], poses: [...pose, ...pose] });
    this.beside_now = new Map();
  }

  add(t, poses) {
    if (t <= this.space.t[this.space.t.length - 1]) return false;
    this.space.t.push(t);
    for (const pose of poses) this.space.poses.push(...pose);
    this.end = t;
    return true;
  }

  place(frame, uav) {
    const at = (frame * this.count + uav) * 7;
    return this.space.poses.slice(at, at + 3);
  }

  beside(uav, now) {
    return this.beside_now.get(this.space.uavs[uav].id) || super.beside(uav, now);
  }
}

/** Time of the newest frame, or an earlier one that was chosen. */
class LiveClock extends Clock {
  constructor() {
    super(0, 0.1);
    this.live = true;
  }

  grow(end) {
    this.end = Math.max(end, 0.1);
    if (this.live) this.now = this.end;
    this.tell();
  }

  seek(time) {
    this.live = time >= this.end;
    super.seek(time);
  }

  toggle() {
    this.live = !this.live;
    if (this.live) this.now = this.end;
    this.tell();
  }
}

class LivePage extends Page {
  begin() {
    const { stage } = this.data;
    byId("space").replaceWith(byId("space").cloneNode()); // without what listened to it
    for (const box of ["events", "charts", "board"]) byId(box).replaceChildren();
    byId("stage").hidden = byId("transport").hidden = false;
    byId("stage").classList.toggle("many", stage.space.uavs.length > MANY);
    byId("name").textContent = stage.name;
    document.title = `${stage.name} – live view`;
    byId("count").textContent = stage.space.uavs.length;
    this.motion = new LiveMotion(this.data.space, stage.starts);
    this.data.space = this.motion.space;
    this.clock = new LiveClock();
    this.board = new Board(this);
    this.scene = new Scene(byId("space"), this.motion, this);
    this.figures = new Figures(byId("charts"), this.data.charts, this, (time) => this.clock.seek(time));
    this.refreshed = 0;
    this.transport();
    this.clock.listen((clock) => {
      this.scene.show(clock.now, false);
      this.figures.show(clock.now);
    });
  }

  transport() {
    const { clock } = this;
    const [slider, now, live] = [byId("time"), byId("now"), byId("golive")];
    slider.oninput = () => clock.seek(Number(slider.value));
    live.onclick = () => clock.toggle();
    clock.listen(() => {
      slider.max = clock.end;
      slider.value = clock.now;
      now.textContent = `${clock.now.toFixed(2)} s`;
      live.setAttribute("aria-pressed", clock.live);
    });
  }

  events() {}

  add(t, poses, errors) {
    if (!this.motion.add(t, poses)) return;
    this.data.charts[0].curves.forEach((curve, k) => {
      curve.t.push(t);
      curve.values.push(errors[k] === null ? NaN : errors[k]);
    });
  }

  frame(frame) {
    if (this.ended) return; // it shows the verdict
    const known = frame.t !== null && frame.uavs.every((uav) => uav.pose);
    if (known) {
      for (const uav of frame.uavs) if (uav.beside) this.motion.beside_now.set(uav.id, uav.beside);
      this.add(frame.t, frame.uavs.map((uav) => uav.pose), frame.uavs.map((uav) => uav.error));
      this.mark(frame);
      this.clock.grow(frame.t);
      if (performance.now() - this.refreshed > REFRESH_MS) {
        this.refreshed = performance.now();
        this.figures.refresh();
      }
    }
    this.board.show(frame);
    this.words(frame);
    this.over = frame.over;
  }

  /** The flight is over: the page stays, with the verdict. */
  end({ verdict, line }) {
    this.ended = true;
    byId("state").className = `verdict ${verdict}`;
    byId("countdown").textContent = verdict;
    byId("line").textContent = line;
    byId("faults").replaceChildren();
    for (const button of document.querySelectorAll("[data-order]")) button.disabled = true;
    this.figures.refresh();
  }

  /** The report is in the page: its link works without the server. */
  report({ page, path }) {
    byId("report").hidden = false;
    byId("report").querySelector("a").href = URL.createObjectURL(new Blob([page], { type: "text/html" }));
    byId("report").querySelector("span").textContent = path && `It is in ${path}.`;
  }

  /** The deadline of each leg in formation. */
  mark(frame) {
    if (frame.left_s === null) return;
    const { marks } = this.data.charts[0];
    const due = frame.t + frame.left_s;
    if (!marks.some(([time]) => Math.abs(time - due) < 0.05)) marks.push([due, "deadline"]);
  }

  words(frame) {
    const { tolerance } = this.data.stage;
    const set = (id, text) => { if (byId(id).textContent !== text) byId(id).textContent = text; };
    set("leg", frame.leg);
    set("clock", frame.t === null ? "–" : `${frame.t.toFixed(1)} s`);
    set("pace", frame.pace === null ? "–" : `${frame.pace.toFixed(2)}×`);
    const errors = frame.uavs.map((uav) => uav.error).filter((one) => one !== null);
    const worst = errors.length ? Math.max(...errors) : null;
    const inside = worst !== null && worst <= tolerance;
    const lost = frame.uavs.some((uav) => uav.lost);
    const landing = frame.leg === "land";
    let countdown = landing ? frame.landing : frame.leg;
    if (frame.left_s !== null) {
      countdown = frame.left_s > 0 ? `${frame.left_s.toFixed(1)} s to the deadline` : `deadline ${(-frame.left_s).toFixed(1)} s ago`;
    }
    set("countdown", frame.over ? "over" : countdown);
    let word = worst === null ? "Waiting for the states of all UAVs." : `Largest error ${worst.toFixed(3)} m, tolerance ${tolerance} m.`;
    if (frame.leg === "waiting") word = "The flight has not begun.";
    if (landing) word = "All UAVs land: the height of the highest, and how many still descend.";
    else if (frame.leg === "hold") word = "All UAVs hold where they are.";
    if (frame.over) word = "The flight is over; the verdict comes when the recording is judged.";
    set("line", word);
    const late = frame.left_s !== null && frame.left_s <= 0;
    byId("state").className = `verdict ${landing || frame.leg === "hold" ? "plain" : lost || (late && !inside) ? "missed" : inside ? "met" : "void"}`;
    const faults = frame.processes.filter((one) => one.level > (landing ? 1 : 0)).slice(0, 6).map(({ name, word, level }) =>
      Object.assign(document.createElement("li"), { textContent: `${name}: ${word}`, className: level > 1 ? "error" : "warning" }));
    byId("faults").replaceChildren(...faults);
    for (const button of document.querySelectorAll("[data-order]")) {
      button.disabled = frame.over || (frame.leg === "waiting" && !button.classList.contains("stop"));
    }
    this.processes(frame.processes);
  }

  processes(all) {
    const levels = ["well", "warning", "error"];
    const rows = all.map(({ name, level, word }) => {
      const row = document.createElement("tr");
      row.className = ["", "warn", "error"][Math.min(level, 2)];
      for (const text of [name, levels[Math.min(level, 2)], word]) row.insertCell().textContent = text;
      return row;
    });
    byId("processes").replaceChildren(...rows);
  }

  redraw() {
    if (!this.scene) return;
    this.board.colours();
    this.scene.draw();
    this.figures.refresh();
  }
}

/** A row of numbers for every UAV. */
class Board {
  constructor(page) {
    this.page = page;
    this.rows = page.data.space.uavs.map((uav) => {
      const row = byId("board").insertRow();
      const cells = ["mode", "number", "before", "before", "number flying", "number", "number flying", "number flying"];
      row.innerHTML = UAV_CELL + cells.map((kind) => `<td class="${kind}"></td>`).join("");
      const button = uavButton(page, row, uav);
      return { uav, row, button, cells: [...row.cells].slice(1) };
    });
    this.colours();
  }

  colours() {
    colourRows(this.page, this.rows);
  }

  show(frame) {
    const number = (value, digits) => (value === null || value === undefined ? "–" : value.toFixed(digits));
    byId("board").parentElement.classList.toggle("waiting", frame.leg === "waiting");
    frame.uavs.forEach((uav, k) => {
      const { row, cells } = this.rows[k];
      const near = uav.near && uav.near.distance !== null ? `${uav.near.distance.toFixed(2)} ·${uav.near.name.replace("UAV ", "")}` : "–";
      const mode = [uav.label, uav.lost ? "lost" : uav.mode, uav.vehicle, uav.armed ? "armed" : null].filter(Boolean).join(", ");
      const text = [mode || "–", number(uav.battery, 0), uav.fix || "–", uav.readiness || "not heard",
        number(uav.error, uav.error !== null && uav.error < 0.1 ? 4 : 3), number(uav.pose && uav.pose[2], 2), number(uav.speed, 2), near];
      text.forEach((one, i) => { if (cells[i].textContent !== one) cells[i].textContent = one; });
      row.classList.toggle("lost", uav.lost);
      row.classList.toggle("inside", Boolean(uav.near && uav.near.room < 0));
    });
  }
}

/** The data of a page that begins: the stage, and the figure of errors without a sample. */
function dataOf(stage) {
  const curves = stage.space.uavs.map((uav) => ({
    label: `UAV ${uav.id}${uav.leader ? " (leader)" : ""}`, uavs: [uav.id], colour: uav.colour, dash: uav.dash, t: [], values: [] }));
  const errors = { key: "errors", title: "Formation error", unit: "m", floor: 1e-4, note: "", band: null,
    limits: [[stage.tolerance, `tolerance ${stage.tolerance} m`]], marks: [], spans: [], curves };
  const space = { ...stage.space, path: Float64Array.from(stage.space.path) };
  return { stage, colours: stage.colours, space, charts: [errors] };
}

class Socket {
  constructor() {
    this.token = new URLSearchParams(location.search).get("token");
    this.failed = 0;
    this.open();
    for (const button of document.querySelectorAll("[data-order]")) {
      button.addEventListener("click", () => this.ask(button.dataset.order));
    }
  }

  open() {
    this.socket = new WebSocket(`ws://${location.host}/socket?token=${encodeURIComponent(this.token)}`);
    this.socket.onmessage = (event) => this.take(JSON.parse(event.data));
    this.socket.onclose = () => this.again();
  }

  again() {
    document.documentElement.dataset.connected = "false";
    if (window.page && (window.page.over || window.page.ended)) return; // nobody answers any more: what is shown stays
    const wait = AGAIN_MS[Math.min(this.failed, AGAIN_MS.length - 1)];
    this.failed += 1;
    byId("state").className = "verdict missed";
    byId("countdown").textContent = "not connected";
    byId("line").textContent = "The connection is lost: what is shown is old. Trying again.";
    for (const button of document.querySelectorAll("[data-order]")) button.disabled = true;
    setTimeout(() => this.open(), wait);
  }

  take(message) {
    if (message.kind === "stage") {
      this.failed = 0;
      if (!message.stage.space) return;
      this.begin(message);
    } else if (message.kind === "frame" && window.page) {
      window.page.frame(message);
    } else if (message.kind === "said") {
      byId("notice").textContent = message.text;
    } else if (window.page && ["end", "report"].includes(message.kind)) window.page[message.kind](message);
  }

  begin({ stage, rows }) {
    const before = window.page;
    const data = dataOf(stage);
    if (before) {
      before.data = data;
      before.begin();
    } else {
      window.page = new LivePage(data);
      window.page.viewKeys();
      document.addEventListener("keydown", (event) => window.page.key(event));
    }
    for (const [t, poses, errors] of rows) window.page.add(t, poses, errors);
    if (rows.length) window.page.clock.grow(rows[rows.length - 1][0]);
    document.documentElement.dataset.ready = "true";
    document.documentElement.dataset.connected = "true";
  }

  ask(order) {
    const dialog = byId("confirm");
    byId("asked").textContent = ORDERS[order];
    dialog.onclose = () => {
      if (dialog.returnValue !== "yes") return;
      this.socket.send(JSON.stringify({ order, token: this.token }));
      byId("notice").textContent = `${document.querySelector(`[data-order=${order}]`).textContent}: sent`;
    };
    dialog.returnValue = "no";
    dialog.showModal();
  }
}

window.live = new Socket();
