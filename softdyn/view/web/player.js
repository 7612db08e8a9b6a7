"use strict";
// Plays robots (figure.js) from a recording in the page, or live from a server. Meshcat's own
// animations only move objects, but cables change shape and colour, and trails grow. Therefore
// frames are (t, q, u, targets of tasks, y, y_ref), and everything is drawn from them.

const CURVES = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"];  // of columns

// One robot in one run: its frames, its trail and its target.
class Track {
  constructor(data, figures, stage, unit) {
    Object.assign(this, data);
    this.figure = new Figure(figures[data.figure], data);
    const {dof, inputs, size, numbers} = this.figure.data;
    [this.dof, this.nu, this.numbers] = [dof, inputs.length, numbers];
    this.stride = 1 + dof + this.nu + numbers + 6;
    this.object = new T.Group();
    this.object.position.set(...data.offset);
    this.object.add(this.figure.object);
    this.trail = new Thread(this.object, data.colour || TRAIL, 0.0026 * size, 0.9);
    this.target = new T.Mesh(new T.SphereGeometry(0.016 * size, 24, 16),
      new T.MeshPhongMaterial(
        {color: TARGET, opacity: 0.75, transparent: true, depthTest: false}));  // never hidden
    this.target.renderOrder = 1;
    this.target.visible = data.aims;
    this.object.add(this.target);
    this.goals = new Goals(this.figure, this.object);
    if (data.path) {
      const line = new Thread(this.object, PATH, 0.0018 * size, 1);
      data.path.forEach(point => line.add(new T.Vector3(...point)));
      line.show(Infinity);
    }
    stage.add(this.object);
    if (data.pulls) {
      const numbers = new Float32Array(bytes(data.pulls)), at = i => numbers.subarray(6 * i, 6 * i + 6);
      this.pulls = Array.from({length: numbers.length / 6}, (_, i) => at(i));
      const forces = this.pulls.map(row => Math.hypot(...row.subarray(0, 3))).filter(f => f > 0);
      this.pull = new Pull(this.object, size, Math.max(...forces));
    }
    this.series = (data.series || []).map(one => ({...one,
      values: one.text ? one.values : new Float32Array(bytes(one.values))}));
    this.frames = [];
    this.push(new Float32Array(bytes(data.frames || "")));
  }
  push(values) {
    for (let i = 0; i + this.stride <= values.length; i += this.stride) {
      const frame = values.subarray(i, i + this.stride);
      this.frames.push(frame);
      this.trail.add(new T.Vector3(...this.vector(frame, 6)));
    }
  }
  vector(frame, back) {
    const at = this.stride - back;
    return [frame[at], frame[at + 1], frame[at + 2]];
  }
  get end() { return this.frames.length ? this.frames[this.frames.length - 1][0] : 0; }
  get failedAt() { return this.failed ? this.end : Infinity; }
  error(frame) {
    const [y, r] = [this.vector(frame, 6), this.vector(frame, 3)];
    return Math.hypot(y[0] - r[0], y[1] - r[1], y[2] - r[2]);
  }
  at(t) {  // the frame before t, and the share of the way to the next one
    let low = 0, high = this.frames.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.frames[middle][0] <= t) low = middle; else high = middle - 1;
    }
    const [a, b] = [this.frames[low], this.frames[Math.min(low + 1, this.frames.length - 1)]];
    return [low, a, b, b[0] > a[0] ? Math.max(0, Math.min(1, (t - a[0]) / (b[0] - a[0]))) : 0];
  }
  draw(t) {
    if (!this.frames.length) return;
    const [i, a, b, s] = this.at(t), q = [];
    for (let k = 0; k < this.dof; k++) {
      let step = b[1 + k] - a[1 + k];
      if (this.figure.turns.has(k) && Math.abs(step) > Math.PI)
        step -= 2 * Math.PI * Math.sign(step);  // a full turn
      q.push(a[1 + k] + s * step);
    }
    this.u = Array.from(a.subarray(1 + this.dof, 1 + this.dof + this.nu));
    this.figure.pose(q, this.u);
    const [now, next] = [this.vector(a, 3), this.vector(b, 3)];
    this.target.position.set(...now.map((x, k) => x + s * (next[k] - x)));
    const goals = 1 + this.dof + this.nu, row = f => f.subarray(goals, goals + this.numbers);
    this.goals.show(row(a), row(b), s);
    this.trail.show(this.aims ? i : 0);
    if (this.pull)
      this.newtons = this.pull.show(this.pulls[i].subarray(0, 3), this.pulls[i].subarray(3));
    this.index = i;
    this.now = this.error(s < 0.5 ? a : b);
    this.tip = this.aims ? this.vector(s < 0.5 ? a : b, 6) : this.figure.tip();
  }
}

class Player {
  constructor(scene) {
    this.scene = scene;
    STOPS = scene.tension;
    [this.viewer, this.stage] = openViewer(document.getElementById("pane"));
    this.find = name => document.getElementById(name);
    this.curves = new Chart(this.find("curves"), new Linear(1e-9, 0));
    this.playing = false;
    this.speed = 1;
    this.time = 0;
    const hash = new URLSearchParams(location.hash.slice(1));
    if (hash.has("opacity")) this.find("opacity").value = hash.get("opacity");
    this.find("wireframe").checked = hash.has("wireframe");
    this.connectControls();
    this.find("inputs").open = this.find("look").open = innerWidth > 640;
    this.buildRows(scene.rows || []);
    document.body.classList.toggle("bare", hash.has("bare"));
    this.select(Number(hash.get("run")) || 0);
    addEventListener("resize", () => { this.frameCamera(); this.drawCurves(); });
    addEventListener("load", () => this.frameCamera());
    if (scene.live) openLink(values => this.tracks[0].push(values), () => {});
    else if (hash.has("t")) this.seek(Number(hash.get("t")));
    else if (!hash.has("pause")) this.play();
    this.before = performance.now();
    const tick = now => {
      requestAnimationFrame(tick);
      this.advance((now - this.before) / 1000);
      this.before = now;
    };
    requestAnimationFrame(tick);
  }

  // -- runs ----------------------------------------------------------------------------------

  select(index) {
    const runs = this.scene.runs;
    this.run = runs[Math.min(index, runs.length - 1)];
    this.find("runs").selectedIndex = index;
    this.find("runs").style.display = runs.length > 1 ? "" : "none";
    this.stage.clear();
    this.tracks = this.run.tracks.map(
      track => new Track(track, this.scene.figures, this.stage));
    this.tracks.forEach((track, i) => track.figure.sink(i));
    this.axes = new Axes(this.stage, this.tracks[0].figure.data.size);
    this.find("axes").replaceChildren("axes ");
    for (const [i, name] of ["x", "y", "z"].entries())
      element(this.find("axes"), "b", name + " ").style.color = AXES[i][0];
    this.find("axes").append(`, each ${this.axes.text}`);
    document.querySelector("#card h1").textContent =
      this.scene.title + (runs.length > 1 ? "" : this.run.title ? ", " + this.run.title : "");
    this.applyLook();
    this.buildLegend();
    this.buildInputs();
    this.buildChannels();
    this.buildJoints();
    this.buildScale();
    this.following = Boolean(this.scene.live);
    document.body.classList.toggle("still", !this.scene.live && this.duration == 0);
    this.seek(0);
    this.frameCamera();
    this.drawCurves();
  }
  get duration() { return Math.max(this.run.duration || 0, ...this.tracks.map(t => t.end)); }

  // -- time ----------------------------------------------------------------------------------

  play() {
    if (this.time >= Math.max(...this.tracks.map(t => t.end)) - 1e-3) this.time = 0;
    this.playing = true;
    this.find("play").textContent = "❚❚";
  }
  pause() { this.playing = false; this.find("play").textContent = "▶"; }
  seek(t) {
    this.time = Math.max(0, Math.min(t, this.duration));
    this.draw();
  }
  advance(seconds) {
    if (this.following) {
      // frames come in batches; a steady lag avoids jumps
      const lag = Math.max(...this.tracks.map(t => t.end)) - this.time;
      if (lag > 0) this.seek(this.time + (lag < 2e-3 ? lag : lag * Math.min(1, seconds / 0.15)));
    } else if (this.playing) {
      let t = this.time + seconds * this.speed;
      if (t >= this.duration) {
        if (this.run.loop) t = 0; else { t = this.duration; this.pause(); }
      }
      this.seek(t);
    }
  }
  draw() {
    for (const track of this.tracks) track.draw(this.time);
    const range = this.find("time");
    range.max = this.duration || 1;
    range.value = this.time;
    const note = this.run.notes ? this.run.notes.filter(([t]) => t <= this.time).pop() : null;
    this.find("clock").value = (note ? note[1] + "  " : "")
      + `${this.time.toFixed(2)} / ${this.duration.toFixed(1)} s`;
    this.updateLegend();
    this.updateInputs();
    this.updateChannels();
    if (this.joints) this.updateJoints();
    this.viewer.set_dirty();
  }

  // -- the card ------------------------------------------------------------------------------

  buildLegend() {
    const list = this.find("legend");
    list.replaceChildren();
    for (const track of this.tracks) {
      if (!track.label) continue;  // one robot: the title names it
      const item = element(list, "li");
      element(item, "i").style.background = track.colour || "#2b6f9e";
      element(item, "b", track.label);
      track.readout = element(item, "output");
      const tip = element(list, "li", undefined, "tip");
      element(tip, "b", "tip at x, y, z");
      track.place = element(tip, "output");
      track.misses = track.goals.marks.map(({name}) => {
        const row = element(list, "li");
        element(row, "i").style.visibility = "hidden";
        element(row, "b", name);
        return element(row, "output");
      });
      if (track.pull) {
        const row = element(list, "li");
        element(row, "i").style.background = "#" + FORCE.toString(16);
        element(row, "b", "pull");
        track.force = element(row, "output");
      }
      if (track.note) element(list, "li", track.note, "note");
    }
  }
  buildRows([title, ...rows]) {
    const box = this.find("rows");
    box.style.display = rows.length ? "" : "none";
    box.open = innerWidth > 640;
    box.querySelector("summary").textContent = title;
    for (const cells of rows) {
      const row = element(box.querySelector("table"), "tr");
      for (const text of cells) element(row, "td", text);
    }
  }
  updateLegend() {
    for (const track of this.tracks) {
      if (!track.readout || track.now === undefined) continue;
      track.place.value = track.tip.map(x => (100 * x).toFixed(1)).join(", ") + " cm";
      if (track.pull) track.force.value = track.newtons ? `${digits(track.newtons)} N` : "none";
      if (!track.aims) continue;
      const gone = this.time > track.failedAt + 1e-6;
      track.goals.misses().forEach((text, i) => { track.misses[i].value = text; });
      track.readout.value = gone ? "ended" : `${(100 * track.now).toFixed(2)} cm`;
    }
  }
  buildInputs() {
    const table = document.querySelector("#inputs table");
    table.replaceChildren();
    this.find("inputs").style.display = this.tracks.some(t => t.nu) ? "" : "none";
    this.bars = [];
    const units = new Set(this.tracks.flatMap(t => t.figure.data.inputs.map(i => i.unit)));
    document.querySelector("#inputs summary").textContent = `inputs (${[...units].join(", ")})`;
    for (const track of this.tracks.slice(0, 4))
      track.figure.data.inputs.forEach((input, i) => {
        const row = element(table, "tr");
        const name = element(row, "td", input.name);
        name.title = input.name;
        if (this.tracks.length > 1) name.style.color = track.colour;
        const bar = element(element(row, "td"), "div"), fill = element(bar, "i");
        const [low, high] = [input.lower, input.upper].map(x => digits(input.factor * x));
        bar.title = `from ${low} to ${high} ${input.unit}`;
        this.bars.push({track, i, input, fill, value: element(row, "td")});
      });
  }
  buildJoints() {  // for a robot whose joints the user sets
    if (!this.scene.sliders || this.joints) return;
    const box = this.find("joints"), [track] = this.tracks;
    box.hidden = false;
    box.open = innerWidth > 640;
    const {coordinates} = track.figure.data, at = folds(box, coordinates.map(({name}) => name));
    this.joints = coordinates.map(({name, lower, upper}, i) => {
      const one = slider(at[i], name, lower, upper, x => {
        const last = track.frames[track.frames.length - 1];
        last[1 + i] = x;
        last.set(track.figure.tip(), last.length - 6);
        this.seek(last[0]);
      });
      one.range.onchange = () => this.frameCamera();
      return one;
    });
  }
  updateJoints() {
    const [{frames}] = this.tracks, last = frames[frames.length - 1];
    if (last) this.joints.forEach(({range, value, held}, i) => {
      if (!held) range.value = last[1 + i];
      value.value = digits(last[1 + i]);
    });
  }
  updateInputs() {
    for (const {track, i, input, fill, value} of this.bars) {
      const u = track.u ? track.u[i] : 0, full = track.figure.full[i] || 1;
      const [lower, upper] = [Math.max(input.lower, -full), Math.min(input.upper, full)];
      const place = x => 100 * (x - Math.min(lower, 0)) / ((Math.max(upper, 0) - Math.min(lower, 0)) || 1);
      const [left, right] = [place(Math.min(u, 0)), place(Math.max(u, 0))];
      fill.style.left = left + "%";
      fill.style.width = Math.max(0.5, right - left) + "%";
      fill.style.background = css(scaled(u / full));
      const x = input.factor * u, size = Math.abs(x);
      const digits = size < 1 ? 3 : size < 10 ? 2 : size < 100 ? 1 : 0;
      value.textContent = x.toFixed(digits).replace(/^-(0[.0]*)$/, "$1");
    }
  }
  buildChannels() {  // a strip for each channel of a user's own, its values beside their names
    const box = this.find("channels");
    for (const old of box.querySelectorAll("div")) old.remove();
    this.strips = this.tracks.flatMap(track => track.series.map(series => {
      const strip = element(box, "div"), columns = series.titles.length;
      const readouts = series.titles.map((title, i) => {
        const row = element(strip, "p");
        element(row, "span", title).style.color = series.text ? "" : CURVES[i % CURVES.length];
        return element(row, "output");
      });
      const made = {track, series, readouts};
      if (series.text) return made;
      made.chart = new Chart(element(strip, "canvas"), new Linear(1e-9), {left: 34});
      made.slots = new Slots(series.titles, this.duration || 1);
      track.frames.forEach((frame, k) => made.slots.push(frame[0], Object.fromEntries(
        series.titles.map((title, i) => [title, series.values[k * columns + i]]))));
      return made;
    }));
    box.style.display = this.strips.length ? "" : "none";
    box.ontoggle = () => this.drawCurves();
  }
  updateChannels() {
    for (const {track, series, readouts} of this.strips)
      readouts.forEach((readout, i) => {
        const value = series.values[(track.index || 0) * readouts.length + i];
        readout.value = series.text ? value || "" : Number.isFinite(value) ? digits(value) : "–";
      });
  }
  buildScale() {
    const scale = this.find("scale");
    const figures = this.tracks.map(t => t.figure).filter(f => f.cables.some(c => c.limit > 0));
    scale.style.display = figures.length ? "" : "none";
    const signed = figures.some(f => f.data.inputs.some(i => i.lower < 0));
    const canvas = scale.querySelector("canvas"), pen = canvas.getContext("2d");
    for (let x = 0; x < canvas.width; x++) {
      const s = x / (canvas.width - 1);
      pen.fillStyle = css(signed ? 2 * s - 1 : s);
      pen.fillRect(x, 0, 1, canvas.height);
    }
    const max = this.tracks.some(t => t.full) ? "most" : "bound";
    const tubes = figures.flatMap(f => f.cables).map(c => c.radius_m > 0);
    const kind = tubes.every(Boolean) ? "pressure" : tubes.some(Boolean)
      ? "tension or pressure" : "cable tension";
    scale.querySelector("p").replaceChildren();
    for (const text of signed ? ["−" + max, "−⅛", "0", "⅛", "+" + max]
      : [tubes.some(Boolean) ? "0" : "slack", "⅛", max]) element(scale.querySelector("p"), "span", text);
    scale.querySelector("b").textContent = max == "most"
      ? `${kind}, of the largest here` : `${kind}, of the input's bound`;
  }

  applyLook() {
    const [opacity, mesh] = [Number(this.find("opacity").value), this.find("wireframe").checked];
    for (const track of this.tracks) track.figure.look(opacity, mesh);
    this.viewer.set_dirty();
  }

  // -- the bar -------------------------------------------------------------------------------

  connectControls() {
    for (const run of this.scene.runs) element(this.find("runs"), "option", run.title);
    this.find("runs").onchange = event => {
      const playing = this.playing;
      this.select(event.target.selectedIndex);
      if (playing) this.play();
    };
    this.find("play").onclick = () => {
      this.following = false;
      if (this.playing) this.pause(); else this.play();
    };
    this.find("time").oninput = event => {
      this.following = false;
      this.pause();
      this.seek(Number(event.target.value));
    };
    this.find("opacity").oninput = this.find("wireframe").onchange = () => this.applyLook();
    this.find("speed").onchange = event => { this.speed = Number(event.target.value); };
    addEventListener("keydown", event => {
      if (event.target.tagName == "SELECT" || event.target.tagName == "BUTTON"
        || event.target.id == "opacity") return;
      const step = {ArrowLeft: -0.1, ArrowRight: 0.1}[event.key];
      if (event.key == " ") this.find("play").click();
      else if (step) { this.pause(); this.seek(this.time + step); } else return;
      event.preventDefault();
    });
  }
  drawCurves() {  // the error over time behind the slider
    const curves = this.tracks.filter(track => track.aims && track.frames.length > 1).map(track => {
      const slots = new Slots(["error"], this.duration || 1, 1000);
      for (const frame of track.frames) slots.push(frame[0], {error: track.error(frame)});
      return {...slots.column("error"), colour: track.colour || "#2b6f9e"};
    });
    this.curves.draw(curves, 0, this.duration || 1);
    for (const {chart, slots, series} of this.strips) if (chart)
      chart.draw(series.titles.map((title, i) => (
        {...slots.column(title), colour: CURVES[i % CURVES.length]})), 0, this.duration || 1);
  }

  // -- the camera ----------------------------------------------------------------------------

  frameCamera() {
    if (!this.tracks) return;
    const points = [], home = this.time;
    for (const track of this.tracks) {
      const size = track.figure.data.size, offset = new T.Vector3(...track.offset);
      const include = (point, margin) => {  // leaves out far points of a diverged run
        if (point.length() > 3 * size) return;
        for (const [x, y, z] of [[1, 0, 0], [0, 1, 0], [0, 0, 1]]) for (const sign of [1, -1])
          points.push(point.clone().add(offset)
            .addScaledVector(new T.Vector3(x, y, z), sign * margin * size));
      };
      const vector = xyz => new T.Vector3(...xyz);
      const robot = () => track.figure.corners().forEach(point => include(point, 0.02));
      const {frames} = track, count = frames.length;
      if (!count) robot();
      for (const part of [0, 0.12, 0.3, 0.6, 1]) if (count) {
        track.draw(frames[Math.round(part * (count - 1))][0]);
        robot();
      }
      if (track.aims) {
        (track.path || []).forEach(p => include(vector(p), 0.03));
        frames.forEach((f, i) => { if (i % 4 == 0) include(track.vector(f, 6).reduce(
          (v, x, k) => v.setComponent(k, x), new T.Vector3()), 0.03); });
        if (count) include(vector(track.vector(frames[0], 3)), 0.04);
      }
      if (this.scene.live)  // the motion is not known yet: leave room around the robot
        for (const x of [-0.6, 0.6]) for (const z of [-0.9, 0.3])
          include(new T.Vector3(x * size, 0, z * size), 0);
    }
    this.seek(home);
    this.axes.place(points);
    const bare = document.body.classList.contains("bare"), narrow = innerWidth < 700;
    const room = bare ? [0.96, 0.96]
      : [narrow ? 0.94 : 1 - 270 / innerWidth, 1 - (narrow ? 230 : 120) / innerHeight];
    // the middle of the part that card and bar leave free
    const shift = bare ? [0, 0] : [narrow ? 0 : 250 / innerWidth, narrow ? -0.1 : 50 / innerHeight];
    fitCamera(this.viewer, points, room, shift);
  }
}
