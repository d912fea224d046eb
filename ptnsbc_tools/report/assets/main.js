// Puts clock, scene, figures and controls together.

const byId = (id) => document.getElementById(id);
const STYLE = ["--card", "--ink", "--soft", "--rule", "--grid", "--accent", "--sky", "--floor", "--halo", "--missed"]; // what is painted with
const PAPER = { width: 680, height: 262 }; // of a figure: A4 within its margins, three on a page [pixels]
const MANY = 12; // UAVs from which on the rows of the table are lower
const SVG_DASHES = ["", "6 3", "6 3 2 3", "2 3"];

class Page {
  constructor(data) {
    this.data = data;
    this.hidden = new Set();
    this.trail = 10;
    this.follow = false;
    this.colours = data.colours.light;
    this.theme(matchMedia("(prefers-color-scheme: dark)").matches);
    if (data.space) this.begin();
    byId("theme").addEventListener("click", () => {
      this.theme(document.documentElement.dataset.theme !== "dark");
      this.redraw();
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", (event) => {
      this.theme(event.matches);
      this.redraw();
    });
  }

  colour({ colour }) {
    return this.colours[colour];
  }

  theme(dark) {
    document.documentElement.dataset.theme = dark ? "dark" : "light";
    byId("theme").textContent = dark ? "Light" : "Dark";
    this.colours = this.data.colours[dark ? "dark" : "light"];
    const css = getComputedStyle(document.documentElement);
    this.style = Object.fromEntries(STYLE.map((name) => [name, css.getPropertyValue(name).trim()]));
  }

  begin() {
    const motion = new Motion(this.data.space);
    byId("stage").hidden = byId("transport").hidden = false;
    byId("stage").classList.toggle("many", motion.count > MANY);
    this.clock = new Clock(motion.begin, motion.end);
    this.motion = motion;
    this.live = new Live(this);
    this.scene = new Scene(byId("space"), motion, this);
    this.figures = new Figures(byId("charts"), this.data.charts, this, (time) => this.clock.seek(time));
    this.transport();
    this.viewKeys();
    this.printing();
    document.addEventListener("keydown", (event) => this.key(event));
    this.clock.listen((clock) => {
      this.scene.show(clock.now, clock.playing);
      this.figures.show(clock.now);
      this.live.show(clock.now);
    });
    const wanted = Number(new URLSearchParams(location.hash.slice(1)).get("t"));
    if (wanted) this.clock.seek(wanted);
  }

  transport() {
    const { clock } = this;
    const [slider, now, play] = [byId("time"), byId("now"), byId("play")];
    const paths = { false: "M3 1.5v13l11-6.5z", true: "M3 2h4v12H3zM9 2h4v12H9z" };
    Object.assign(slider, { min: clock.begin, max: clock.end, step: "any" });
    slider.addEventListener("input", () => clock.seek(Number(slider.value)));
    play.addEventListener("click", () => clock.toggle());
    byId("speed").addEventListener("change", (event) => { clock.speed = Number(event.target.value); });
    this.events();
    clock.listen(() => {
      slider.value = clock.now;
      const words = `${clock.now.toFixed(2)} s`;
      now.textContent = words;
      slider.setAttribute("aria-valuetext", words);
      play.setAttribute("aria-label", clock.playing ? "Pause" : "Play");
      play.querySelector("path").setAttribute("d", paths[clock.playing]);
    });
  }

  /** Legs, changes, deadlines and encounters above the slider. */
  events() {
    const { begin, end } = this.clock;
    const part = (time) => `${(100 * (Math.min(Math.max(time, begin), end) - begin)) / (end - begin)}%`;
    const add = (kind, style) => {
      const one = document.createElement("div");
      one.className = kind;
      Object.assign(one.style, style);
      byId("events").append(one);
      return one;
    };
    for (const uav of this.data.space.uavs) {
      for (const [from, to] of uav.avoiding) add("span", { left: part(from), right: `calc(100% - ${part(to)})` });
    }
    for (const uav of this.data.space.uavs) {
      for (const [from, to] of uav.deadlocks) {
        add("span stuck", { left: part(from), right: `calc(100% - ${part(to)})` });
        const words = Object.assign(document.createElement("span"), { textContent: `UAV ${uav.id}: deadlock` });
        add("mark", { left: part(from) }).append(words);
      }
    }
    for (const [time, name] of this.data.space.marks) {
      const words = Object.assign(document.createElement("span"), { textContent: name });
      add("mark", { left: part(time) }).append(words);
    }
    this.spread();
    window.addEventListener("resize", () => this.spread());
  }

  /** The names above the slider in rows, so that none stands on another; one for which no row is left is not shown. */
  spread() {
    const ends = [0, 0];
    const names = [...document.querySelectorAll("#events .mark span")];
    const places = new Map(names.map((words) => [words, words.getBoundingClientRect()]));
    for (const words of names.sort((a, b) => places.get(a).left - places.get(b).left)) {
      const { left, right } = places.get(words);
      const row = ends.findIndex((taken) => left > taken + 6);
      words.style.visibility = row < 0 ? "hidden" : "visible";
      words.dataset.row = Math.max(row, 0);
      if (row >= 0) ends[row] = right;
    }
  }

  /** What is printed is complete: all figures, and all details open. */
  printing() {
    this.figures.rest();
    let opened = [];
    window.addEventListener("beforeprint", () => {
      opened = [...document.querySelectorAll("details:not([open])")];
      for (const one of opened) one.open = true;
      this.figures.resize(PAPER);
    });
    window.addEventListener("afterprint", () => {
      for (const one of opened) one.open = false;
      this.figures.resize(null);
    });
  }

  viewKeys() {
    const views = {
      home: () => { this.setFollow(false); this.scene.camera.reset(); },
      top: () => this.scene.camera.reset(-Math.PI / 2, Math.PI / 2 - 1e-3),
      side: () => this.scene.camera.reset(-Math.PI / 2, 0.04),
      follow: () => this.setFollow(!this.follow),
    };
    this.views = views;
    for (const button of document.querySelectorAll("[data-view]")) {
      button.addEventListener("click", () => { views[button.dataset.view](); this.scene.draw(); });
    }
    byId("trail").addEventListener("change", (event) => { this.trail = Number(event.target.value); this.scene.draw(); });
  }

  setFollow(follow) {
    this.follow = follow;
    document.querySelector("[data-view=follow]").setAttribute("aria-pressed", follow);
    const { camera } = this.scene;
    if (follow) camera.distance = Math.min(camera.distance, 12);
    else camera.target = [...camera.home.centre];
    this.scene.draw();
  }

  key(event) {
    const busy = event.target.closest("button, select, summary, a");
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const { clock } = this;
    const slider = event.target === byId("time");
    const step = event.shiftKey ? 1 : 0.1;
    const keys = {
      ArrowLeft: () => clock.seek(clock.now - step), ArrowRight: () => clock.seek(clock.now + step),
      Home: () => clock.seek(clock.begin), End: () => clock.seek(clock.end),
      f: () => { this.views.follow(); this.scene.draw(); },
      r: () => { this.views.home(); this.scene.draw(); },
    };
    if (event.key === " " && !busy) clock.toggle();
    else if (keys[event.key] && (slider || !event.target.closest("select, .scroll, pre"))) keys[event.key]();
    else return;
    event.preventDefault();
  }

  /** Hide or show a UAV; `alone`: show it and nobody else, or everybody again. */
  toggle(uav, alone) {
    const others = this.data.space.uavs.map((one) => one.id).filter((id) => id !== uav);
    if (alone) {
      const already = !this.hidden.has(uav) && others.every((id) => this.hidden.has(id));
      this.hidden = new Set(already ? [] : others);
    } else if (!this.hidden.delete(uav)) this.hidden.add(uav);
    this.redraw();
  }

  redraw() {
    if (!this.scene) return;
    this.live.colours();
    this.live.show(this.clock.now);
    this.scene.draw();
    this.figures.refresh();
  }
}

/** The first cell of a UAV's row: a button with its line and name, which hides it. */
const UAV_CELL = '<td><button type="button" class="uav" aria-pressed="true"><svg viewBox="0 0 26 10" aria-hidden="true">' +
  '<line x1="1" x2="25" y1="5" y2="5" stroke-width="3"/></svg><span></span></button></td>';

/** Give the button of every row the name of its UAV, and what a click on it does. */
function uavButton(page, row, uav) {
  const button = row.querySelector("button");
  button.querySelector("span").textContent = uav.leader ? `${uav.id} leader` : `${uav.id}`;
  button.title = `Show or hide UAV ${uav.id}; with shift: it alone`;
  button.addEventListener("click", (event) => page.toggle(uav.id, event.shiftKey));
  return button;
}

/** Lines of the rows in the colours of the page; those of hidden UAVs are not pressed. */
function colourRows(page, rows) {
  for (const { uav, button } of rows) {
    const line = button.querySelector("line");
    line.setAttribute("stroke", page.colour(uav));
    line.setAttribute("stroke-dasharray", SVG_DASHES[uav.dash]);
    button.setAttribute("aria-pressed", !page.hidden.has(uav.id));
  }
}

/** Numbers of every UAV at the time of the playback. */
class Live {
  constructor(page) {
    this.page = page;
    const errors = page.data.charts.find((chart) => chart.key === "errors");
    this.rows = page.data.space.uavs.map((uav, index) => {
      const row = byId("live").insertRow();
      row.innerHTML = UAV_CELL + '<td class="number"></td>'.repeat(4);
      const button = uavButton(page, row, uav);
      const curve = errors && errors.curves.find((one) => one.uavs[0] === uav.id);
      return { uav, index, row, button, curve, cells: [...row.querySelectorAll(".number")] };
    });
    this.colours();
  }

  colours() {
    colourRows(this.page, this.rows);
  }

  show(now) {
    byId("live-time").textContent = `${now.toFixed(2)} s`;
    const { motion } = this.page;
    const poses = this.rows.map(({ index }) => motion.pose(index, now));
    for (const { uav, index, row, curve, cells } of this.rows) {
      const near = this.nearest(poses, index, now);
      const text = [
        curve && now >= curve.t[0] ? this.error(valueAt(curve, now)) : "–",
        poses[index][2].toFixed(2), motion.speed(index, now).toFixed(2),
        near ? `${near.distance.toFixed(2)} ${near.name}` : "–",
      ];
      text.forEach((one, k) => { if (cells[k].textContent !== one) cells[k].textContent = one; });
      row.classList.toggle("clear", inside(uav.avoiding, now));
      row.classList.toggle("stuck", inside(uav.deadlocks, now));
      row.classList.toggle("inside", Boolean(near && near.room < 0));
    }
  }

  error(value) {
    return Number.isFinite(value) ? value.toFixed(value < 0.1 ? 4 : 3) : "none";
  }

  /** What leaves the least room. */
  nearest(poses, index, now) {
    const { uavs, obstacles, keepOutHeight } = this.page.data.space;
    const own = poses[index];
    const gap = (place) => Math.hypot(own[0] - place[0], own[1] - place[1], (own[2] - place[2]) / keepOutHeight);
    const found = [
      ...uavs.map((uav, k) => ({
        name: `·${uav.id}`, distance: gap(poses[k]), limit: (uavs[index].keepOut + uav.keepOut) / 2, self: k === index,
      })),
      ...obstacles.map((one) => ({
        name: `·${one.name}`,
        distance: distanceTo(one, this.page.motion.obstacle(one, now), own),
        limit: one.keepOut,
      })),
    ].filter((one) => !one.self && Number.isFinite(one.distance));
    for (const one of found) one.room = one.distance - one.limit;
    return found.reduce((best, one) => (!best || one.room < best.room ? one : best), null);
  }
}
