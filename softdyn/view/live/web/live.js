"use strict";
// A robot that runs somewhere else: draws its frames, and sends the user's actions to the server.

const REACH = 0x1b9e77, GHOST = "#7b52ab";
const SPANS = [[12, "12 s"], [60, "1 min"], [300, "5 min"]];  // of the plots
const LEAST = 1e-4;  // on a logarithmic axis
const EVERY = 33;  // ms between two messages of one drag
const INK = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"];
const KEYS = [
  [" ", "space", "run or pause", "play"], [".", ".", "one control period", "step"],
  ["r", "r", "reset: at rest again", "reset"], ["v", "v", "record, and stop", "record"],
  ["g", "g", "model or estimate beside the plant", "ghost"], ["h", "h", "where the tip can rest", "reach"],
  ["t", "t", "turn or move the target", "turn"], ["n", "n", "the next target"],
  ["o", "o", "open loop and back"], ["f", "f", "look at the robot"],
  ["+", "+ −", "faster, slower"], ["?", "?", "these keys", "ask"],
];
const MOUSE = "Drag the target in the plane of the robot's axes that faces you; with Shift, in depth; "
  + "by an arrow, along it. "
  + "Turn it by its rings. "
  + "Drag a link to pull it. Drag beside the robot to turn, wheel to zoom.";
const MISMATCH = [  // name, label, least, most, factor of what is shown, unit
  ["mass", "mass", 0.5, 2, 1, "×"], ["stiffness", "stiffness", 0.5, 2, 1, "×"],
  ["damping", "damping", 0.5, 2, 1, "×"], ["delay", "delay", 0, 0.03, 1e3, "ms"],
  ["noise", "noise", 0, 0.005, 1e3, "mm"],
];

/** A strip: one or more curves of the last seconds, with a title and the newest numbers. */
class Strip {
  /**
   * @param {HTMLElement} parent
   * @param {string} title
   * @param {[string, string][]} curves column and colour of each
   * @param {Linear|Logarithmic|Symmetric} scale
   * @param {number[]} marks values with a dashed line
   */
  constructor(parent, title, curves, scale, marks = []) {
    this.box = element(parent, "div", undefined, "plot");
    element(this.box, "b", title);
    this.readout = element(this.box, "output");
    this.curves = curves;
    this.chart = new Chart(element(this.box, "canvas"), scale, {left: 40, bottom: 12, marks});
  }

  /**
   * @param {Slots} slots
   * @param {string} text the newest numbers
   */
  show(slots, text) {
    const curves = this.curves.map(([name, colour]) => ({...slots.column(name), colour}));
    this.chart.draw(curves, ...slots.shown);
    this.readout.value = text;
  }
}

class Live {
  constructor(scene) {
    this.scene = scene;
    STOPS = scene.tension;
    [this.viewer, this.stage] = openViewer(document.getElementById("pane"));
    this.find = name => document.getElementById(name);
    this.state = {paused: false, law: "", mismatch: {}, inputs: []};
    this.pending = new Map();  // unsent messages of a drag
    this.sent = -Infinity;  // time of a drag's last message
    this.leads = false;
    this.size = scene.figure.size;
    const look = {opacity: 1};
    this.figure = new Figure(scene.figure, look);
    this.stage.add(this.figure.object);
    this.goals = new Goals(this.figure, this.stage);
    const inputs = scene.figure.inputs.map((_, i) => "u" + i);
    const columns = ["error", "V", "step", "wake", "misses", "gap", ...inputs];
    this.recent = SPANS.map(([span]) => new Slots(columns, span));
    this.makeTarget();
    this.makeOverlays();
    this.makeCard();
    this.makeSide();
    this.makeBar();
    this.makeHand();
    this.frameCamera();
    addEventListener("load", () => this.frameCamera());
    addEventListener("resize", () => this.frameCamera());
    this.connect();
    const tick = () => {
      requestAnimationFrame(tick);
      if (this.fresh) this.draw();
    };
    requestAnimationFrame(tick);
    setInterval(() => this.plot(), 100);
  }

  // -- the websocket -----------------------------------------------------------------------

  connect() {
    this.link = openLink(frame => this.take(frame), news => this.told(news));
    this.link.onclose = event => {
      this.notice(event.reason || (this.kept ? this.state.notice
        : "the server has ended; the page keeps what it has"));
      document.body.classList.add("over");
      this.command(false);
    };
  }
  say(message) {  // after a drag's unsent messages, to keep the order
    this.flush();
    if (!document.body.classList.contains("over")) this.notice(this.state.notice || "");
    this.send(message);
  }
  send(message) {
    if (this.link.readyState == 1) this.link.send(JSON.stringify(message));
  }
  flush() {
    clearTimeout(this.later);
    this.later = null;
    if (this.pending.size) this.sent = performance.now();
    for (const message of this.pending.values()) this.send(message);
    this.pending.clear();
  }
  often(message) {  // messages of a drag: not at every event, but always the last one
    this.pending.delete(message.do);
    this.pending.set(message.do, message);
    const wait = this.sent + EVERY - performance.now();
    if (wait <= 0) this.flush();
    else this.later ??= setTimeout(() => this.flush(), wait);
  }
  told(news) {
    if (news.error) this.notice(news.error);
    if (news.reach) this.addReach(news.reach);
    if (news.recorded) {
      const link = this.find("recorded");
      link.href = news.recorded + location.search;
      link.hidden = false;
    }
    if (news.replay) this.keep(news.replay);
    if (news.state) {
      Object.assign(this.state, news.state);
      this.leads = news.leads;
      this.pages = news.pages;
      this.command(news.leads);
      this.find("lead").hidden = news.leads || this.scene.mode == "watch";
      this.find("record").classList.toggle("on", news.recording);
      this.find("record").textContent = news.recording ? "■ stop" : "● record";
      this.showState();
    }
  }
  notice(text) { this.find("notice").textContent = text; }
  keep(page) {  // a page that needs no server
    this.kept = true;
    const link = this.find("recorded");
    link.href = URL.createObjectURL(new Blob([page], {type: "text/html"}));
    link.textContent = "look at the whole run";
    link.removeAttribute("download");
    link.target = "_blank";
    link.hidden = false;
  }
  command(can) {
    for (const set of document.querySelectorAll(".command")) set.disabled = !can;
    if (!can) this.held = null;
    this.handle.enable(can && this.aims);
    if (!this.handle.enabled) for (const name of ["target", "targets"]) this.pending.delete(name);
  }
  get aims() { return this.scene.mode == "play" && this.state.law != this.scene.open; }

  // -- frames ------------------------------------------------------------------------------

  part(frame, name) {
    const [at, size] = this.scene.columns[name];
    return frame.subarray(at, at + size);
  }
  one(frame, name) { return frame[this.scene.columns[name][0]]; }
  take(frame) {
    this.last = frame;
    this.fresh = true;
    this.frames = (this.frames || 0) + 1;
    const t = this.one(frame, "t");
    if (t == this.time) return;
    if (t < this.time) {
      for (const slots of this.recent) slots.clear();
      this.trail.count = 0;
    }
    this.time = t;
    const [y, r] = [this.part(frame, "y"), this.part(frame, "y_ref")];
    const row = {V: this.one(frame, "V"), step: this.one(frame, "step_us"),
      wake: this.one(frame, "wake_us"), misses: this.one(frame, "misses"),
      gap: 1e3 * this.one(frame, "gap"),
      error: this.aims || this.scene.mode == "watch"
        ? 100 * Math.hypot(y[0] - r[0], y[1] - r[1], y[2] - r[2]) : NaN};
    const {inputs} = this.scene.figure;
    this.part(frame, "u").forEach((u, i) => { row["u" + i] = inputs[i].factor * u; });
    for (const slots of this.recent) slots.push(t, row);
    this.row = row;
    this.leaveTrail(y);
  }
  draw() {
    this.fresh = false;
    const frame = this.last, u = Array.from(this.part(frame, "u"));
    this.figure.pose(Array.from(this.part(frame, "q")), u);
    const targets = this.part(frame, "targets");
    this.goals.show(targets, targets, 0, this.handle.dragging ? this.aim : null);
    if (!this.handle.dragging) this.placeTarget(frame);
    this.target.visible = this.aims || this.scene.mode == "watch";
    const ghost = this.part(frame, "ghost");
    this.ghost.object.visible = Number.isFinite(ghost[0]);
    if (this.ghost.object.visible) this.ghost.pose(Array.from(ghost), u);
    this.drawForce(this.part(frame, "force"), this.part(frame, "point"));
    this.drawEllipsoid(this.part(frame, "compliance"), this.part(frame, "y"));
    this.showFrame(frame, u);
    this.viewer.set_dirty();
  }
  leaveTrail(y) {
    const {trail} = this, place = trail.geometry.attributes.position, n = place.count;
    if (trail.count == n) place.array.copyWithin(0, 3);
    else trail.count++;
    place.array.set(y, 3 * (trail.count - 1));
    place.needsUpdate = true;
    trail.geometry.setDrawRange(0, trail.count);
  }

  // -- what there is in the scene ----------------------------------------------------------

  makeTarget() {
    this.target = new T.Mesh(new T.SphereGeometry(0.02 * this.size, 24, 16),
      new T.MeshPhongMaterial({color: TARGET, opacity: 0.75, transparent: true, depthTest: false}));
    this.target.renderOrder = 1;
    this.stage.add(this.target);
    this.handle = new Handle(this.viewer, this.target, this.size);
    this.handle.changed = () => this.often(this.aim ? this.aimed()
      : {do: "target", y: this.target.position.toArray()});
  }
  placeTarget(frame) {
    const {target, aim} = this;
    if (!aim) return target.position.set(...this.part(frame, "y_ref"));
    target.position.copy(aim.object.position);
    // moved along the robot's axes, turned about its own
    if (this.handle.turns) target.quaternion.copy(aim.object.quaternion);
    else target.quaternion.identity();
  }
  aimed() {  // the targets of all tasks, that of the dragged one as it is dragged
    const {aim, target} = this, values = Array.from(this.part(this.last, "targets"));
    if (this.handle.turns) {
      aim.object.quaternion.copy(target.quaternion);
      this.goals.numbers(target.quaternion, aim).toArray(values, aim.first + (aim.placed ? 3 : 0));
    } else {
      aim.object.position.copy(target.position);
      target.position.toArray(values, aim.first);
    }
    return {do: "targets", values};
  }
  choose(mark, turn) {  // the task whose target the mouse drags
    this.aim = mark;
    this.handle.turns = Boolean(mark) && (turn && mark.kind != "position" || !mark.placed);
    this.find("goal").value = this.goals.marks.indexOf(mark);
    this.find("turn").hidden = mark.kind != "pose";
    this.find("turn").textContent = this.handle.turns ? "move it" : "turn it";
    if (this.last) this.placeTarget(this.last);
    this.viewer.set_dirty();
  }
  makeOverlays() {
    this.trail = new T.Line(new T.BufferGeometry(), new T.LineBasicMaterial({color: TRAIL}));
    this.trail.geometry.setAttribute(
      "position", new T.BufferAttribute(new Float32Array(3 * 300), 3));
    this.trail.frustumCulled = false;
    this.trail.count = 0;
    this.trail.geometry.setDrawRange(0, 0);
    this.pull = new Pull(this.stage, this.size, this.scene.pull);
    this.ghost = new Figure(this.scene.figure, {opacity: 0.35,
      tint: this.scene.mode == "explore" ? "#d3202f" : GHOST});
    for (const {rods} of this.ghost.cables) for (const rod of rods) rod.visible = false;
    this.ghost.object.visible = false;
    this.points = new T.Points(new T.BufferGeometry(), new T.PointsMaterial(
      {color: REACH, size: 4, sizeAttenuation: false, transparent: true, opacity: 0.65}));
    this.points.frustumCulled = false;
    this.rests = [];
    this.ellipsoid = new T.Mesh(new T.SphereGeometry(1, 28, 18), new T.MeshBasicMaterial(
      {color: FORCE, opacity: 0.35, transparent: true, depthWrite: false}));
    this.ellipsoid.matrixAutoUpdate = false;
    this.ellipsoid.visible = false;
    for (const object of [this.trail, this.ghost.object, this.points, this.ellipsoid])
      this.stage.add(object);
    if (this.scene.path) {
      const line = new Thread(this.stage, PATH, 0.0018 * this.size, 1);
      this.scene.path.forEach(point => line.add(new T.Vector3(...point)));
      line.show(Infinity);
    }
  }
  addReach(points) {
    this.rests.push(...points);
    this.points.geometry.setAttribute(
      "position", new T.Float32BufferAttribute(this.rests.flat(), 3));
    this.viewer.set_dirty();
  }
  drawForce(force, point) {
    const newtons = this.pull.show(force, point), label = this.find("newtons");
    label.style.visibility = newtons ? "visible" : "hidden";
    if (!newtons) return;
    const end = this.stage.localToWorld(this.pull.end.clone()).project(this.viewer.camera);
    label.value = `${digits(newtons)} N`;
    label.style.transform =
      `translate(${(end.x + 1) / 2 * innerWidth + 8}px, ${(1 - end.y) / 2 * innerHeight - 10}px)`;
  }
  drawEllipsoid(compliance, y) {
    this.ellipsoid.visible = Number.isFinite(compliance[0]);
    this.softest = NaN;
    if (!this.ellipsoid.visible) return;
    const c = compliance, rows = [0, 3, 6], [a, b] = [new T.Vector3(1, 0.7, 0.4), new T.Vector3()];
    for (let k = 0; k < 40; k++) {  // its largest eigenvalue, by powers
      rows.forEach((at, i) => b.setComponent(i, c[at] * a.x + c[at + 1] * a.y + c[at + 2] * a.z));
      this.softest = b.length() / (a.length() || 1);
      a.copy(b).normalize();
    }
    const s = 0.12 * this.size / (this.softest || 1);  // scale the unit ball's image to a visible size
    this.ellipsoid.matrix.set(s * c[0], s * c[1], s * c[2], y[0], s * c[3], s * c[4], s * c[5], y[1],
      s * c[6], s * c[7], s * c[8], y[2], 0, 0, 0, 1);
  }
  frameCamera() {
    const s = this.size;
    const points = this.figure.corners().filter(at => at.length() < 2 * s);  // no floor's far ones
    for (const x of [-0.6, 0.6]) for (const z of [-0.9, 0.25])
      points.push(new T.Vector3(x * s, 0, z * s));
    const narrow = innerWidth < 640, left = narrow ? 0 : 250, right = narrow ? 0
      : this.find("side").offsetWidth + 14;
    fitCamera(this.viewer, points, [1 - (left + right) / innerWidth, 1 - 130 / innerHeight],
      [(left - right) / innerWidth, 50 / innerHeight]);
  }

  // -- a hand on a link --------------------------------------------------------------------

  makeHand() {
    const pane = this.viewer.dom_element;
    pane.addEventListener("pointerdown", event => {
      const busy = this.held || this.handle.dragging;  // with another finger
      if (!busy && (event.button != 0 || !this.leads || !this.grasp(event))) return;
      event.stopImmediatePropagation();  // Meshcat's own controls do not see it
      if (!busy) pane.setPointerCapture(this.pointer = event.pointerId);
    }, true);
    pane.addEventListener("pointermove", event => {
      if (!this.held) {
        if (!this.handle.dragging || event.pointerId == this.pointer) this.handle.move(event);
        return;
      }
      if (event.pointerId != this.pointer) return;
      const to = pointerRay(this.viewer, event).intersectPlane(this.held.plane, new T.Vector3());
      if (to) this.often({do: "push", link: this.held.name, at: this.held.at,
        to: this.stage.worldToLocal(to).toArray()});
    });
    const release = event => {
      if (event.pointerId != this.pointer) return;
      this.handle.release();
      if (!this.held) return;
      this.held = null;
      this.pending.delete("push");
      this.say({do: "release"});
    };
    pane.addEventListener("pointerup", release);
    pane.addEventListener("pointercancel", release);
  }

  /** Takes what is under the pointer: the target's handle, another target, or a link. */
  grasp(event) {
    if (this.handle.press(event)) return true;
    if (this.scene.mode != "play") return false;
    const rays = new T.Raycaster();
    rays.ray.copy(pointerRay(this.viewer, event));
    const marks = this.goals.marks.map(mark => mark.object);
    const mark = this.aims && rays.intersectObjects(marks, true)[0];
    if (mark) {  // a click chooses a target
      this.choose(this.goals.marks[marks.indexOf(mark.object.parent)], this.handle.turns);
      return true;
    }
    const hit = rays.intersectObjects(this.figure.shapes)[0];
    if (!hit) return false;
    const shape = this.figure.shapes.indexOf(hit.object);
    const link = this.scene.figure.shapes[shape].link;
    this.held = {
      name: this.scene.links[link],
      at: this.figure.links[link].worldToLocal(hit.point.clone()).toArray(),
      plane: new T.Plane().setFromNormalAndCoplanarPoint(
        this.viewer.camera.getWorldDirection(new T.Vector3()), hit.point),
    };
    return true;
  }

  // -- panels ------------------------------------------------------------------------------

  makeCard() {
    document.querySelector("#card h1").textContent = this.scene.title;
    const legend = this.find("legend"), row = name => {
      const item = element(legend, "li");
      element(item, "b", name);
      return element(item, "output");
    };
    this.readouts = this.scene.mode == "explore"
      ? {rest: row("rest"), tip: row("tip (m)"), compliance: row("softest (mm/N)")}
      : {error: row("error"), tip: row("tip (m)"), time: row("time"),
        goals: this.goals.marks.map(({name}) => row(name))};
    const {inputs, coordinates} = this.scene.figure;
    const boxes = folds(this.find("inputs"), inputs.map(({name}) => name));
    this.inputs = inputs.map((input, i) => {
      const full = Math.max(-input.lower, input.upper) || 1;
      const made = slider(boxes[i], input.name, Math.cbrt(input.lower / full),
        Math.cbrt(input.upper / full), () => {
          const u = this.inputs.map(one => one.full * one.range.value ** 3)
            .map((x, k) => Math.min(Math.max(x, this.scene.figure.inputs[k].lower),
              this.scene.figure.inputs[k].upper));
          this.asked = u;
          this.often({do: "inputs", u});
          this.showInputs(u);
        });
      return Object.assign(made, {full});
    });
    if (this.inputs.length) element(this.find("inputs"), "p",
      `in ${this.scene.unit}; fine near 0: half way is ⅛ of the bound`, "note");
    const explore = this.scene.mode == "explore";
    this.find("joints").style.display = explore ? "" : "none";
    const places = folds(this.find("joints"), coordinates.map(({name}) => name));
    this.joints = (explore ? coordinates : []).map(({name, lower, upper}, i) => slider(
      places[i], name, lower, upper, x => {
        this.joints[i].value.value = digits(x);
        this.asked = null;
        this.often({do: "joints", x: this.joints.map(one => Number(one.range.value))});
      }));
  }
  /** Whether the inputs of a frame are those that the sliders asked for last, or are refused. */
  answered(u) {
    const same = this.asked && this.asked.every((x, i) => Math.abs(x - u[i]) <= 1e-5 * this.inputs[i].full);
    if (same || this.state.notice) this.asked = null;
    return !this.asked;
  }
  showInputs(u) {
    // by hand the sliders keep the commands, and the numbers show what acts: behind a rig they differ
    const open = this.scene.mode == "play" && this.state.law == this.scene.open;
    u.forEach((value, i) => {
      const {name, range, value: out, full, held} = this.inputs[i];
      const {factor} = this.scene.figure.inputs[i];
      const said = held ? full * range.value ** 3 : open ? this.state.inputs[i] ?? value : value;
      if (!held) range.value = Math.cbrt(said / full);
      name.style.borderColor = css(scaled(value / full));
      const shown = open ? value : said;
      out.value = Math.abs(shown) < 1e-6 * full ? "0" : digits(factor * shown);
    });
  }
  makeSide() {
    const play = this.scene.mode == "play";
    this.find("law-row").hidden = this.find("mismatch").hidden = this.find("ghost").parentElement
      .hidden = !play;
    if (this.scene.mode == "watch") this.find("overlays").style.display = "none";
    const law = this.find("law");
    for (const name of this.scene.laws) element(law, "option", name);
    const goal = this.find("goal");
    this.goals.marks.forEach(({name}, i) => { element(goal, "option", name).value = i; });
    this.find("goal-row").hidden = !play || !this.goals.marks.length;
    goal.onchange = () => { this.choose(this.goals.marks[goal.value], false); goal.blur(); };
    this.find("turn").onclick = event => {
      event.currentTarget.blur();
      if (this.aim) this.choose(this.aim, !this.handle.turns);
    };
    if (play && this.goals.marks.length) this.choose(this.goals.marks.find(mark => mark.placed), false);
    law.onchange = () => {
      if (law.value != this.scene.open) this.closed = law.value;
      this.say({do: "law", name: law.value});
      law.blur();
    };
    const box = document.querySelector("#mismatch div");
    this.mismatch = {};
    for (const [name, label, low, high, factor, unit] of MISMATCH) {
      const one = slider(box, label, low, high, x => {
        one.value.value = `${digits(factor * x)} ${unit}`;
      });
      one.range.onchange = () => this.sayMismatch();
      this.mismatch[name] = one;
    }
    const contacts = element(element(box, "label", undefined, "row"), "input");
    contacts.type = "checkbox";
    contacts.id = "contacts";
    contacts.before("links touch");
    contacts.onchange = () => this.sayMismatch();
    this.find("ghost").nextElementSibling.textContent = this.scene.ghost;
    this.find("ghost").onchange = event => this.say({do: "ghost", on: event.target.checked});
    this.find("reach").onclick = () => {
      if (!this.rests.length) this.say({do: "reach"});
      else this.points.visible = !this.points.visible;
      this.viewer.set_dirty();
    };
    if (this.scene.mode == "explore") return;
    this.makePlots();
  }
  makePlots() {
    const box = this.find("plots"), {inputs} = this.scene.figure, log = new Logarithmic(LEAST);
    const bounds = [...new Set(inputs.flatMap(i => [i.factor * i.lower, i.factor * i.upper]))];
    const small = Math.min(...inputs.map(i => i.factor * Math.max(-i.lower, i.upper))) / 100 || 1;
    const [first, second] = INK;
    this.plots = {
      error: new Strip(box, "error (cm)", [["error", first]], log),
      inputs: inputs.length && new Strip(box, `inputs (${this.scene.unit})`,
        inputs.map((_, i) => ["u" + i, INK[i % INK.length]]), new Symmetric(small),
        bounds.length <= 4 ? bounds : []),
      V: new Strip(box, "V", [["V", first]], log),
      time: new Strip(box, "control step, wake-up error (µs)", [["step", first], ["wake", second]],
        log, [1e6 * this.scene.period]),
      misses: new Strip(box, "missed periods", [["misses", first]], new Linear(1)),
      gap: new Strip(box, `tip, plant against ${this.scene.ghost} (mm)`, [["gap", GHOST]], log),
    };
    const span = this.find("span");
    for (const [, text] of SPANS) element(span, "option", text);
    span.parentElement.hidden = false;
    span.onchange = () => { this.plot(); span.blur(); };
  }
  sayMismatch() {
    const said = {do: "mismatch", contacts: this.find("contacts").checked};
    for (const [name, {range}] of Object.entries(this.mismatch)) said[name] = Number(range.value);
    this.say(said);
    if (document.activeElement) document.activeElement.blur();
  }
  plot() {
    const {plots, row} = this;
    if (!plots || !row) return;
    const slots = this.recent[this.find("span").selectedIndex];
    const show = (strip, text) => strip && strip.show(slots, text);
    show(plots.error, digits(row.error));
    show(plots.inputs, "");
    show(plots.V, digits(row.V));
    show(plots.time, `${digits(row.step)}, ${digits(row.wake)}`);
    show(plots.misses, Number.isFinite(row.misses) ? String(row.misses) : "–");
    plots.gap.box.hidden = !this.state.ghost;
    if (this.state.ghost) show(plots.gap, digits(row.gap));
  }
  makeBar() {
    const does = {
      play: () => this.say({do: "pause", on: !this.state.paused}),
      step: () => this.say({do: "step"}),
      reset: () => this.say({do: "reset"}),
      record: () => this.say({do: "record", on: !this.find("record").classList.contains("on")}),
      lead: () => this.say({do: "lead"}),
      ask: () => this.find("keys").open ? this.find("keys").close() : this.find("keys").showModal(),
    };
    for (const [name, act] of Object.entries(does)) this.find(name).onclick = event => {
      event.currentTarget.blur();
      act();
    };
    const speed = this.find("speed"), play = this.scene.mode == "play";
    this.speeds = [0.1, 0.25, 0.5, 1, 2, 5];
    for (const x of this.speeds) element(speed, "option", `${x}×`).value = x;
    speed.onchange = () => { this.say({do: "speed", factor: Number(speed.value)}); speed.blur(); };
    if (!play) document.querySelector("#bar fieldset").style.display = "none";
    this.find("bar").hidden = this.scene.mode == "explore";
    for (const [, shown, about] of KEYS) {
      const row = element(document.querySelector("#keys table"), "tr");
      element(element(row, "td"), "kbd", shown);
      element(row, "td", about);
    }
    document.querySelector("#keys p").textContent = MOUSE;
    document.querySelector("#keys button").onclick = () => this.find("keys").close();
    addEventListener("keydown", event => {
      const tag = event.target.tagName, typed = tag == "SELECT"
        || tag == "INPUT" && (event.target.type != "range" || event.key.startsWith("Arrow"));
      if (typed || event.ctrlKey || event.metaKey || event.altKey) return;
      const known = KEYS.find(([key]) => key == event.key);
      const faster = {"+": 1, "=": 1, "-": -1}[event.key];
      if (event.key == "f") this.frameCamera();
      else if (event.key == "n" && this.aim) {
        const {marks} = this.goals;
        this.choose(marks[(marks.indexOf(this.aim) + 1) % marks.length], false);
      } else if (event.key == "o" && this.scene.mode == "play") {
        const {open} = this.scene, now = this.state.law;
        if (now != open) this.closed = now;
        this.say({do: "law", name: now == open ? this.closed || this.scene.laws[0] : open});
      } else if (faster) {
        const at = this.speeds.indexOf(this.state.speed), to = this.speeds[at + faster];
        if (to) this.say({do: "speed", factor: to});
      } else if (known && known[3]) this.find(known[3]).click();
      else return;
      event.preventDefault();
    });
  }
  showState() {
    const {state} = this;
    this.find("play").textContent = state.paused ? "▶" : "❚❚";
    this.find("speed").value = state.speed;
    if (document.activeElement != this.find("law")) this.find("law").value = state.law;
    this.find("ghost").checked = state.ghost;
    this.find("contacts").checked = Boolean(state.mismatch.contacts);
    for (const [name, , , , factor, unit] of MISMATCH) {
      const {range, value} = this.mismatch[name], x = state.mismatch[name] ?? Number(range.min);
      if (document.activeElement != range) {
        range.value = x;
        value.value = `${digits(factor * x)} ${unit}`;
      }
    }
    const by_hand = this.scene.mode == "explore" || state.law == this.scene.open;
    for (const {range} of this.inputs) range.disabled = !by_hand;
    // an error stays until the next action or the next error
    if (state.notice !== this.stated) this.notice(state.notice || "");
    this.stated = state.notice;
    if (state.busy) this.find("clock").value = state.busy;
  }
  showFrame(frame, u) {
    const {readouts} = this, tip = this.part(frame, "y");
    const explore = this.scene.mode == "explore";
    if (!explore || !this.inputs.some(one => one.held) && this.answered(u)) this.showInputs(u);
    readouts.tip.value = Array.from(tip, x => x.toFixed(3)).join(", ");
    if (explore) {
      const stable = this.one(frame, "stable");
      const ghost = this.ghost.object.visible;
      readouts.rest.value = (stable == 1 ? "stable" : stable == 0 ? "UNSTABLE" : "joints by hand")
        + (ghost ? ", red: unstable" : "");
      readouts.rest.style.color = stable == 0 || ghost ? "#a11420" : "";
      readouts.compliance.value = digits(1e3 * this.softest);
      Array.from(this.part(frame, "q")).forEach((x, i) => {
        const {range, value, held} = this.joints[i];
        if (held) return;
        range.value = x;
        value.value = digits(x);
      });
      return;
    }
    const t = this.one(frame, "t"), pace = this.one(frame, "pace");
    const r = this.part(frame, "y_ref");
    const error = 100 * Math.hypot(tip[0] - r[0], tip[1] - r[1], tip[2] - r[2]);
    readouts.error.value = this.target.visible ? `${error.toFixed(2)} cm` : "open loop";
    readouts.time.value = `${t.toFixed(2)} s`;
    this.goals.misses().forEach((text, i) => { readouts.goals[i].value = text; });
    const wanted = this.state.speed || 1, slow = pace > 0 && pace < 0.95 * wanted;
    this.find("clock").value = this.state.busy || (this.state.planning ? "planning… · " : "") + (this.kept ? "over" : this.state.paused ? "paused"
      : !Number.isFinite(pace) ? "" : `${pace.toFixed(2)} × real time` + (slow ? ": this machine cannot keep up" : ""))
      + (this.pages > 1 ? ` · ${this.pages} pages` : "")
      + (this.leads || this.scene.mode == "watch" ? "" : " · watching");
  }
}
