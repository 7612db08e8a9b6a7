"use strict";
// A robot in a Meshcat viewer: its links, cables and colours, and a camera that looks at it.

const T = MeshCat.THREE;
let STOPS = [];  // colours of tension, from the page
const TARGET = 0xd3202f, PATH = 0x8a94a0, TRAIL = 0x2b6f9e, FORCE = 0xe07b00;

function shade(value) {  // [-1, 1] -> [r, g, b] in 0 ... 1
  const x = Math.max(-1, Math.min(1, value || 0));
  let i = 1;
  while (i < STOPS.length - 1 && x > STOPS[i][0]) i++;
  const [a, b] = [STOPS[i - 1], STOPS[i]], s = (x - a[0]) / (b[0] - a[0]);
  return [1, 2, 3].map(k => (a[k] + s * (b[k] - a[k])) / 255);
}
// the scale of the colours: most tensions are a few per cent of their bounds
const scaled = part => Math.cbrt(part);
const css = value => "rgb(" + shade(value).map(c => Math.round(255 * c)).join(" ") + ")";

function bytes(text) {
  return Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer;
}

function element(parent, tag, text, name) {
  const made = document.createElement(tag);
  if (text !== undefined) made.textContent = text;
  if (name) made.className = name;
  parent.append(made);
  return made;
}

function digits(x) {
  const size = Math.abs(x);
  return !Number.isFinite(x) ? "–" : size < 1e-9 ? "0"
    : size < 1e-3 || size >= 1e5 ? x.toExponential(1)
    : size < 1 ? x.toFixed(3) : size < 100 ? x.toFixed(2) : x.toFixed(0);
}

const MOST_OPEN = 8;  // sliders in a row; more of them are folded
const RUN = 6;  // sliders in a fold of names that have nothing in common

/**
 * The parent of each of many sliders: a fold for names that differ in their last number alone.
 *
 * @param {HTMLElement} box
 * @param {string[]} names
 */
function folds(box, names) {
  if (names.length <= MOST_OPEN) return names.map(() => box);
  const stems = names.map(name => name.replace(/[\s._-]*\d+$/, "")), count = new Set(stems).size;
  const alike = count > 1 && count <= names.length / 2;
  const keys = names.map((_, i) => alike ? stems[i] : Math.floor(i / RUN));
  const made = new Map();
  for (const key of new Set(keys)) {
    const own = names.filter((_, i) => keys[i] == key), fold = element(box, "details");
    const ends = own.length > 1 ? `${own[0]} … ${own[own.length - 1]}` : own[0];
    element(fold, "summary", ends);
    fold.open = made.size == 0;
    made.set(key, fold);
  }
  return keys.map(key => made.get(key));
}

/** A slider; while it is `held`, its number is the user's, else that of what is shown. */
function slider(parent, name, low, high, onInput) {
  const row = element(parent, "label", undefined, "slider");
  const label = element(row, "span", name);
  label.title = name;
  const range = element(row, "input");
  Object.assign(range, {type: "range", min: low, max: high, step: "any"});
  range.setAttribute("aria-label", name);
  const value = element(row, "output");
  const made = {name: label, range, value, held: false};
  range.oninput = () => {
    made.held = true;
    onInput(Number(range.value));
  };
  range.addEventListener("change", () => { made.held = false; });  // at the end of a drag
  return made;
}

const ROD = new T.CylinderGeometry(1, 1, 1, 10, 1);
const TUBE = new T.CylinderGeometry(1, 1, 1, 10, 1, true);  // open, because caps would show between rods
const UP = new T.Vector3(0, 1, 0), LAID = new T.Object3D();

function lay(object, a, b, radius) {  // a rod from a to b
  const along = new T.Vector3().subVectors(b, a), length = along.length();
  object.position.addVectors(a, b).multiplyScalar(0.5);
  if (length > 1e-9) object.quaternion.setFromUnitVectors(UP, along.divideScalar(length));
  object.scale.set(radius, Math.max(length, 1e-9), radius);
}

// A force: an arrow at its point, of full length at the force `most`.
class Pull {
  constructor(parent, size, most) {
    [this.size, this.most] = [size, most];
    this.arrow = new T.ArrowHelper(new T.Vector3(0, 0, 1), new T.Vector3(), 1, FORCE);
    this.arrow.visible = false;
    this.end = new T.Vector3();
    parent.add(this.arrow);
  }
  show(force, point) {  // the force's size (N)
    const newtons = Math.hypot(...force);
    this.arrow.visible = newtons > 0;
    if (!(newtons > 0)) return 0;
    const way = new T.Vector3(...force).divideScalar(newtons);
    const length = this.size * (0.05 + 0.45 * Math.min(1, newtons / this.most));
    this.arrow.position.set(...point);
    this.arrow.setDirection(way);
    this.arrow.setLength(length, 0.05 * this.size, 0.03 * this.size);
    this.end.copy(this.arrow.position).addScaledVector(way, length);
    return newtons;
  }
}

// Rods through points; one may show only the first few.
class Thread {
  constructor(parent, colour, radius, opacity) {
    this.parent = parent;
    this.radius = radius;
    this.material = new T.MeshBasicMaterial(
      {color: colour, transparent: opacity < 1, opacity: opacity});
    this.last = null;
    this.count = 0;
    this.reserve(256);
  }
  reserve(size) {
    const mesh = new T.InstancedMesh(ROD, this.material, size);
    mesh.frustumCulled = false;
    for (let i = 0, m = new T.Matrix4(); i < this.count; i++) {
      this.mesh.getMatrixAt(i, m);
      mesh.setMatrixAt(i, m);
    }
    if (this.mesh) {
      this.parent.remove(this.mesh);
      this.mesh.dispose();
    }
    this.parent.add(this.mesh = mesh);
    this.size = size;
  }
  add(point) {
    if (this.last) {
      if (this.count == this.size) this.reserve(2 * this.size);
      const rod = new T.Object3D();
      lay(rod, this.last, point, this.radius);
      rod.updateMatrix();
      this.mesh.setMatrixAt(this.count++, rod.matrix);
      this.mesh.instanceMatrix.needsUpdate = true;
    }
    this.last = point;
  }
  show(count) { this.mesh.count = Math.max(0, Math.min(count, this.count)); }
  clear() { this.count = 0; this.last = null; this.show(0); }
}

// A surface through rings on links; between two rings a cubic curve tangent to their axes.
class Skin {
  constructor(figure, rings, look) {
    const sides = 28, steps = rings.length > 100 ? 1 : 4, last = rings.length - 1;
    this.carriers = rings.map(ring => {
      const carrier = new T.Object3D();
      new T.Matrix4().fromArray(ring.pose)
        .decompose(carrier.position, carrier.quaternion, carrier.scale);
      figure.links[ring.link].add(carrier);
      return {carrier, place: new T.Vector3(), turn: new T.Quaternion(), axis: new T.Vector3()};
    });
    const at = (i, t, radius, cap) => ({i: Math.min(i, last - 1), t, radius, cap});
    this.rows = [at(0, 0, 0, -1), at(0, 0, rings[0].radius, -1)];  // cap: direction of the normal
    for (let k = 0; k <= last * steps; k++) {
      const i = Math.min(Math.floor(k / steps), last - 1), t = k / steps - i;
      this.rows.push(at(i, t, (1 - t) * rings[i].radius + t * rings[i + 1].radius, 0));
    }
    this.rows.push(at(last, 1, rings[last].radius, 1), at(last, 1, 0, 1));
    this.circle = Array.from({length: sides}, (_, k) =>
      [Math.cos(2 * Math.PI * k / sides), Math.sin(2 * Math.PI * k / sides)]);
    const count = this.rows.length * sides, faces = [], colours = [];
    this.rows.forEach(({i, t}, row) => {
      const colour = new T.Color(...rings[t < 0.5 ? i : i + 1].rgba.slice(0, 3));
      if (look.tint) colour.lerp(new T.Color(look.tint), 0.72);
      for (let k = 0; k < sides; k++) {
        colours.push(colour.r, colour.g, colour.b);
        const a = row * sides + k, b = row * sides + (k + 1) % sides;
        if (row) faces.push(a - sides, b - sides, b, a - sides, b, a);
      }
    });
    const geometry = new T.BufferGeometry();
    for (const name of ["position", "normal"])
      geometry.setAttribute(name, new T.BufferAttribute(new Float32Array(3 * count), 3));
    geometry.setAttribute("color", new T.Float32BufferAttribute(colours, 3));
    geometry.setIndex(faces);
    const opacity = rings[0].rgba[3] * look.opacity;
    this.mesh = new T.Mesh(geometry, new T.MeshPhongMaterial({vertexColors: true,
      opacity: opacity, transparent: opacity < 1, depthWrite: opacity > 0.35,
      side: T.DoubleSide, shininess: 22, specular: 0x222222}));
    this.mesh.material.own = opacity;
    this.mesh.frustumCulled = false;
    figure.object.add(this.mesh);
  }
  pose(home) {
    const matrix = new T.Matrix4(), size = new T.Vector3();
    for (const {carrier, place, turn, axis} of this.carriers) {
      matrix.multiplyMatrices(home, carrier.matrixWorld).decompose(place, turn, size);
      axis.set(0, 0, 1).applyQuaternion(turn);
    }
    const {position, normal} = this.mesh.geometry.attributes, turn = new T.Quaternion();
    const [centre, out, [x, y, z]] = [new T.Vector3(), new T.Vector3(),
      [new T.Vector3(), new T.Vector3(), new T.Vector3()]];
    let n = 0;
    for (const {i, t, radius, cap} of this.rows) {
      const [a, b] = [this.carriers[i], this.carriers[i + 1]], d = a.place.distanceTo(b.place);
      const s = t * t * (3 - 2 * t), u = 1 - t;
      centre.copy(a.place).multiplyScalar(1 - s).addScaledVector(b.place, s)
        .addScaledVector(a.axis, d * t * u * u).addScaledVector(b.axis, -d * t * t * u);
      matrix.makeRotationFromQuaternion(turn.copy(a.turn).slerp(b.turn, t))
        .extractBasis(x, y, z);
      for (const [c, q] of this.circle) {
        out.copy(x).multiplyScalar(c).addScaledVector(y, q);
        position.setXYZ(n, centre.x + radius * out.x, centre.y + radius * out.y,
          centre.z + radius * out.z);
        if (cap) out.copy(z).multiplyScalar(cap);
        normal.setXYZ(n++, out.x, out.y, out.z);
      }
    }
    position.needsUpdate = normal.needsUpdate = true;
  }
}

// Whether no input pulls a cable that can be slack, and it is no longer than its spring's rest.
function isSlack(cable, q, pull) {
  if (!cable.slackens || Math.abs(pull) > 1e-6 * cable.limit) return false;
  const length = cable.terms.length
    ? cable.terms.reduce((sum, [index, coef]) => sum + coef * q[index], 0)
    : cable.points.slice(1).reduce((sum, p, i) => sum + p.distanceTo(cable.points[i]), 0);
  return cable.rest === null || length <= cable.rest;
}

function dim(material, opacity) {
  if (material.opacity != opacity)
    Object.assign(material, {opacity, transparent: opacity < 1, needsUpdate: true});
}

// The points of a cable with its arcs around round bodies. Each body adds as many points at all
// times, so that the number of rods is fixed.
const ARC = 24, TURN = 2 * Math.PI;

function withArcs(cable, home) {
  if (!cable.wraps.length) return cable.ends;
  const points = [];
  cable.ends.forEach((end, i) => {
    points.push(end);
    const wrap = cable.wraps.find(one => one.after === i);
    if (!wrap) return;
    const next = cable.ends[i + 1];
    const there = home.clone().multiply(wrap.body.matrixWorld), back = there.clone().invert();
    const arc = arcAround(wrap, end.clone().applyMatrix4(back), next.clone().applyMatrix4(back));
    for (let k = 0; k <= ARC; k++)
      points.push(arc ? arc[k].applyMatrix4(there) : end.clone().lerp(next, (k + 1) / (ARC + 2)));
  });
  return points;
}

// The arc from a to b in a body's frame, null if the cable is straight: softdyn/dynamics/wraps.py.
function arcAround(wrap, a, b) {
  const r = wrap.radius, side = wrap.side && new T.Vector3(...wrap.side);
  let x = new T.Vector3(1, 0, 0), y = new T.Vector3(0, 1, 0), z = new T.Vector3(0, 0, 1);
  if (wrap.sphere) {
    x = a.clone().normalize();
    for (const other of [b, side, y, z]) {
      if (!other) continue;
      y = other.clone().addScaledVector(x, -other.dot(x));
      if (y.length() > 1e-9 * other.length()) break;
    }
    y.normalize();
    z = x.clone().cross(y);
  }
  const flat = v => [v.dot(x), v.dot(y)], cross = (p, q) => p[0] * q[1] - p[1] * q[0];
  const p = flat(a), q = flat(b), way = [q[0] - p[0], q[1] - p[1]];
  const ra = Math.hypot(...p), rb = Math.hypot(...q), square = way[0] ** 2 + way[1] ** 2;
  if (Math.min(ra, rb) < r * (1 - 1e-9) || square < 1e-15) return null;
  const share = -(way[0] * p[0] + way[1] * p[1]) / square;
  const meets = share > 0 && share < 1 && Math.hypot(p[0] + share * way[0], p[1] + share * way[1]) <= r;
  const from = Math.atan2(p[1], p[0]), to = Math.atan2(q[1], q[0]);
  let sense = cross(p, q) >= 0 ? 1 : -1, first, turn, before, length;
  if (wrap.inside) {
    if (meets) return null;
    const span = ((sense * (to - from)) % TURN + TURN) % TURN;
    const of = s => Math.hypot(p[0] - r * Math.cos(from + sense * s), p[1] - r * Math.sin(from + sense * s))
      + Math.hypot(q[0] - r * Math.cos(from + sense * s), q[1] - r * Math.sin(from + sense * s));
    let low = 0, high = span;
    for (let k = 0; k < 60; k++) {
      const one = low + (high - low) / 3, two = high - (high - low) / 3;
      if (of(one) < of(two)) high = two; else low = one;
    }
    first = from + sense * low;
    turn = 0;
    before = Math.hypot(p[0] - r * Math.cos(first), p[1] - r * Math.sin(first));
    length = of(low);
  } else {
    const s = side && flat(side);
    const far = s && cross(s, p) * sense > 0 && cross(q, s) * sense > 0;
    if (far) sense = -sense;
    else if (!meets) return null;
    const [one, two] = [Math.acos(Math.min(r / ra, 1)), Math.acos(Math.min(r / rb, 1))];
    turn = ((sense * (to - from) - one - two) % TURN + TURN) % TURN;
    first = from + sense * one;
    before = r * Math.tan(one);
    length = before + r * turn + r * Math.tan(two);
  }
  return Array.from({length: ARC + 1}, (_, k) => {
    const angle = first + sense * turn * k / ARC;
    const point = x.clone().multiplyScalar(r * Math.cos(angle)).addScaledVector(y, r * Math.sin(angle));
    if (!wrap.sphere) point.z = a.z + (b.z - a.z) * (before + r * turn * k / ARC) / length;
    return point;
  });
}

// A robot: a tree of groups that the joints move.
class Figure {
  constructor(data, look) {
    this.data = data;
    this.object = new T.Group();
    this.links = Array.from({length: data.links}, () => new T.Group());
    const child = new Set(data.joints.map(joint => joint.child));
    this.links.forEach((link, i) => { if (!child.has(i)) this.object.add(link); });
    for (const joint of data.joints) {
      const fixed = new T.Group();
      new T.Matrix4().fromArray(joint.pose)
        .decompose(fixed.position, fixed.quaternion, fixed.scale);
      this.links[joint.parent].add(fixed);
      fixed.add(this.links[joint.child]);
    }
    this.moving = data.joints.filter(joint => joint.index >= 0)
      .map(joint => ({...joint, axis: new T.Vector3(...joint.axis)}));
    const meshes = data.meshes.map(geometryOf);
    this.shapes = [];
    this.turns = new Set(this.moving.filter(joint => joint.turns).map(joint => joint.index));
    for (const shape of data.shapes) {
      const geometry = shape.mesh !== undefined ? meshes[shape.mesh]
        : shape.box ? new T.BoxGeometry(...shape.box)
        : shape.cylinder ? new T.CylinderGeometry(
            shape.cylinder[0], shape.cylinder[0], shape.cylinder[1], 40).rotateX(Math.PI / 2)
        : new T.SphereGeometry(shape.sphere, 28, 18);
      const colour = new T.Color(...shape.rgba.slice(0, 3));
      if (look.tint) colour.lerp(new T.Color(look.tint), 0.72);
      const opacity = shape.rgba[3] * look.opacity;
      const mesh = new T.Mesh(geometry, new T.MeshPhongMaterial({
        color: colour, opacity: opacity, transparent: opacity < 1, depthWrite: opacity > 0.35,
        side: T.DoubleSide, shininess: 22, specular: 0x222222}));
      mesh.material.own = opacity;
      mesh.matrixAutoUpdate = false;
      mesh.matrix.fromArray(shape.pose);  // set whole, because it may mirror
      (this.links[shape.link] || this.object).add(mesh);
      geometry.computeBoundingBox();
      mesh.covered = Boolean(shape.skin && data.skins);
      mesh.visible = !mesh.covered;  // hidden shapes still catch the pointer
      this.shapes.push(mesh);
    }
    this.skins = (data.skins || []).map(rings => new Skin(this, rings, look));
    const radius = 0.005 * data.size;
    this.full = look.full || data.inputs.map(i => Math.max(-i.lower, i.upper));
    this.cables = data.cables.map(cable => {
      const limit = cable.weights.reduce((sum, w, i) => sum + Math.abs(w) * this.full[i], 0);
      const material = new T.MeshBasicMaterial();
      const sites = cable.sites.map(([link, ...xyz]) => {
        const site = new T.Object3D();
        site.position.set(...xyz);
        this.links[link].add(site);
        return site;
      });
      // the part inside the body shines through
      const hidden = new T.MeshBasicMaterial({depthFunc: T.GreaterDepth, depthWrite: false,
        transparent: true, opacity: 0.45});
      const wraps = (cable.wraps || []).map(wrap => {
        const body = new T.Object3D();
        body.matrixAutoUpdate = false;
        body.matrix.fromArray(wrap.pose);
        this.links[wrap.link].add(body);
        return {...wrap, body};
      });
      const pieces = sites.length - 1 + wraps.length * (ARC + 1);
      const rods = [[ROD, material], [TUBE, hidden]]
        .map(([form, one]) => new T.InstancedMesh(form, one, pieces));
      rods[1].instanceMatrix = rods[0].instanceMatrix;
      rods[1].renderOrder = 1;
      rods.forEach(rod => { rod.frustumCulled = false; this.object.add(rod); });
      return {...cable, limit, material, hidden, sites, wraps, rods,
        radius: cable.radius_m || radius,
        ends: sites.map(() => new T.Vector3())};
    });
    this.pose(new Array(data.dof).fill(0), new Array(data.inputs.length).fill(0));
  }
  pose(q, u) {
    for (const joint of this.moving) {
      const link = this.links[joint.child], value = joint.gain * q[joint.index] + joint.offset;
      if (joint.slides) link.position.copy(joint.axis).multiplyScalar(value);
      else link.quaternion.setFromAxisAngle(joint.axis, value);
    }
    if (this.data.floating) {  // position and rotation vector of the root
      const base = this.links[this.data.root], turn = new T.Vector3(q[3], q[4], q[5]);
      const angle = turn.length();
      base.position.set(q[0], q[1], q[2]);
      base.quaternion.setFromAxisAngle(angle > 0 ? turn.divideScalar(angle) : UP, angle);
    }
    this.object.updateMatrixWorld(true);
    const home = this.object.matrixWorld.clone().invert();
    for (const cable of this.cables) {
      cable.sites.forEach((site, i) =>
        cable.ends[i].setFromMatrixPosition(site.matrixWorld).applyMatrix4(home));
      cable.points = withArcs(cable, home);
      let pull = cable.weights.reduce((sum, weight, i) => sum + weight * u[i], 0);
      if (cable.side) pull = cable.side * Math.max(0, cable.side * pull);
      const part = cable.limit > 0 ? scaled(pull / cable.limit) : 0;
      const slack = isSlack(cable, q, pull);
      dim(cable.material, slack ? 0.6 : 1);
      cable.hidden.opacity = slack ? 0.25 : 0.45;
      cable.material.color.setRGB(...(cable.rgba ? cable.rgba.slice(0, 3) : shade(part)));
      cable.hidden.color.copy(cable.material.color);
      cable.points.slice(1).forEach((_, i) => {
        const wide = cable.radius_m ? 1 : slack ? 0.4 : 0.75 + 0.5 * Math.abs(part);
        lay(LAID, cable.points[i], cable.points[i + 1], cable.radius * wide);
        LAID.updateMatrix();
        cable.rods[0].setMatrixAt(i, LAID.matrix);
      });
      cable.rods[0].instanceMatrix.needsUpdate = true;
    }
    this.skins.forEach(skin => skin.pose(home));
  }
  look(opacity, wireframe) {  // of the links only, because they hide the cables
    const set = (material, value) => Object.assign(material,
      {opacity: value, transparent: value < 1, depthWrite: value > 0.35, needsUpdate: true});
    for (const mesh of this.shapes) {
      const value = mesh.material.own * opacity;
      // a fine mesh as lines would still be opaque, so draw its edges and a faint surface
      if (wireframe && !mesh.children.length)
        mesh.add(new T.LineSegments(new T.EdgesGeometry(mesh.geometry, 15),
          new T.LineBasicMaterial({color: mesh.material.color})));
      set(mesh.material, wireframe ? 0.1 * value : value);
      mesh.visible = wireframe || !mesh.covered;
      for (const edges of mesh.children) {
        edges.visible = wireframe;
        set(edges.material, value);
      }
    }
    for (const {mesh} of this.skins) {
      set(mesh.material, mesh.material.own * opacity);
      mesh.visible = !wireframe;
    }
  }
  corners() {  // of the boxes around its shapes, in the axes of the group that it is in
    this.object.updateWorldMatrix(true, true);
    const home = this.object.parent.matrixWorld.clone().invert(), found = [];
    for (const {geometry: {boundingBox: {min, max}}, matrixWorld} of this.shapes)
      for (const x of [min.x, max.x]) for (const y of [min.y, max.y]) for (const z of [min.z, max.z])
        found.push(new T.Vector3(x, y, z).applyMatrix4(matrixWorld).applyMatrix4(home));
    return found;
  }
  sink(depth) {  // behind another robot in the same place, whose equal surfaces would flicker
    this.object.traverse(({material}) => {
      if (material) Object.assign(material,
        {polygonOffset: depth > 0, polygonOffsetFactor: depth, polygonOffsetUnits: depth});
    });
  }
  tip() {  // in the robot's own frame
    const home = this.object.matrixWorld.clone().invert();
    return new T.Vector3().setFromMatrixPosition(this.links[this.data.tip].matrixWorld)
      .applyMatrix4(home).toArray();
  }
}

// The tasks of a robot: each target, and thin on the robot the axes that shall come to it. A target
// is a ball for a point, three axes for a rotation, an arrow for a direction.
const AXES = [["#d3202f", 0], ["#1b8a3a", 1], ["#1f5fbf", 2]];

class Goals {
  constructor(figure, parent) {
    const {size, marks} = figure.data;
    this.figure = figure;
    this.parent = parent;
    let at = 0;
    this.marks = marks.map(mark => {
      const placed = mark.kind == "position" || mark.kind == "pose";
      const made = {...mark, first: at, placed, turned: mark.kind == "pose" || mark.kind == "orientation"};
      at += mark.kind == "pose" ? 6 : 3;
      made.object = new T.Group();
      made.own = new T.Group();
      if (placed) made.own.position.set(...mark.vector);
      if (mark.kind == "axis") made.way = new T.Vector3(...mark.vector);
      if (placed) made.object.add(this.ball(0.014 * size));
      if (made.turned) {
        this.axes(made.object, 0.14 * size, 0.0035 * size);
        this.axes(made.own, 0.1 * size, 0.0016 * size);
      }
      if (mark.kind == "axis") {
        this.arrow(made.object, "#d3202f", 0.16 * size, 0.004 * size, 2);
        this.arrow(made.own, TRAIL, 0.12 * size, 0.0025 * size, 2);
        made.own.quaternion.setFromUnitVectors(new T.Vector3(0, 0, 1), made.way);
      }
      figure.links[mark.link].add(made.own);
      parent.add(made.object);
      return made;
    });
    // a rotation or a direction stands where its link's target is, if there is one
    for (const mark of this.marks) mark.host = mark.placed ? mark
      : this.marks.find(other => other.placed && other.link == mark.link);
  }
  ball(radius) {
    const ball = new T.Mesh(new T.SphereGeometry(radius, 24, 16), this.paint(TARGET));
    ball.renderOrder = 1;
    return ball;
  }
  paint(color) {  // never hidden
    return new T.MeshPhongMaterial({color, opacity: 0.85, transparent: true, depthTest: false});
  }
  axes(group, length, radius) {
    for (const [colour, axis] of AXES) this.arrow(group, colour, length, radius, axis);
  }
  arrow(group, colour, length, radius, axis) {
    const way = new T.Vector3().setComponent(axis, 1), paint = this.paint(colour);
    const rod = new T.Mesh(ROD, paint), head = new T.Mesh(new T.ConeGeometry(3 * radius, 9 * radius, 16), paint);
    lay(rod, new T.Vector3(), way.clone().multiplyScalar(length), radius);
    head.position.copy(way).multiplyScalar(length);
    head.quaternion.setFromUnitVectors(UP, way);
    for (const one of [rod, head]) {
      one.renderOrder = 1;
      group.add(one);
    }
  }
  turn(mark, values) {
    const [x, y, z] = values.subarray(mark.first + (mark.placed ? 3 : 0)), way = new T.Vector3(x, y, z);
    if (!mark.turned) return new T.Quaternion().setFromUnitVectors(new T.Vector3(0, 0, 1), way.normalize());
    const angle = way.length();
    return new T.Quaternion().setFromAxisAngle(angle > 0 ? way.divideScalar(angle) : UP, angle);
  }
  numbers(quaternion, mark) {  // of a rotation, or of a direction
    if (!mark.turned) return new T.Vector3(0, 0, 1).applyQuaternion(quaternion);
    const {x, y, z, w} = quaternion, size = Math.hypot(x, y, z), sign = w < 0 ? -1 : 1;
    return new T.Vector3(x, y, z).multiplyScalar(
      size > 0 ? 2 * sign * Math.atan2(size, Math.abs(w)) / size : 0);
  }
  misses() {  // distance and angle of each target, as text
    const home = this.parent.matrixWorld.clone().invert(), there = new T.Matrix4();
    return this.marks.map(mark => {
      const [place, turn, size] = [new T.Vector3(), new T.Quaternion(), new T.Vector3()];
      there.multiplyMatrices(home, mark.own.matrixWorld).decompose(place, turn, size);
      const goal = mark.object, angle = mark.turned ? turn.angleTo(goal.quaternion)
        : this.numbers(turn, mark).angleTo(this.numbers(goal.quaternion, mark));
      if (!goal.visible) return "–";
      return [...mark.placed ? [`${(100 * place.distanceTo(goal.position)).toFixed(2)} cm`] : [],
        ...mark.kind == "position" ? [] : [`${(180 / Math.PI * angle).toFixed(1)}°`]].join(", ");
    });
  }
  place(mark, a, b, s) {
    const at = mark.first, host = new T.Vector3(a[at], a[at + 1], a[at + 2]);
    return host.lerp(new T.Vector3(b[at], b[at + 1], b[at + 2]), s);
  }
  // targets between two rows of numbers; a mark that `held` names stays
  show(a, b, s, held) {
    const home = this.parent.matrixWorld.clone().invert();
    for (const mark of this.marks) {
      mark.object.visible = Number.isFinite(a[mark.first]);
      if (mark == held || !mark.object.visible) continue;
      if (mark.host && Number.isFinite(a[mark.host.first]))
        mark.object.position.copy(this.place(mark.host, a, b, s));
      else mark.object.position.setFromMatrixPosition(this.figure.links[mark.link].matrixWorld)
        .applyMatrix4(home);
      if (mark.kind == "position") continue;
      mark.object.quaternion.copy(this.turn(mark, a));
      if (s > 0) mark.object.quaternion.slerp(this.turn(mark, b), s);
    }
  }
}

// The world's axes beside the robots, a round length long.
class Axes {
  constructor(parent, size) {
    const power = 10 ** Math.floor(Math.log10(0.25 * size));
    const length = power * [5, 2, 1].find(x => x * power <= 0.25 * size);
    this.text = `${Number((100 * length).toPrecision(3))} cm`;
    this.object = new T.Group();
    for (const [colour, axis] of AXES) {
      const way = new T.Vector3().setComponent(axis, 1), paint = new T.MeshBasicMaterial({color: colour});
      const rod = new T.Mesh(ROD, paint), radius = 0.004 * size;
      const head = new T.Mesh(new T.ConeGeometry(3 * radius, 8 * radius, 16), paint);
      lay(rod, new T.Vector3(), way.clone().multiplyScalar(length - 4 * radius), radius);
      head.position.copy(way).multiplyScalar(length - 4 * radius);
      head.quaternion.setFromUnitVectors(UP, way);
      this.object.add(rod, head);
    }
    parent.add(this.object);
  }
  place(points) {  // at the lower left of what the camera shows, and in front
    const {min} = new T.Box3().setFromPoints(points);
    this.object.position.copy(min);
  }
}

function geometryOf(mesh) {
  const packed = new Uint16Array(bytes(mesh.vertices)), vertices = new Float32Array(packed.length);
  for (let i = 0; i < packed.length; i++)
    vertices[i] = mesh.low[i % 3] + packed[i] / 65535 * mesh.span[i % 3];
  const faces = bytes(mesh.faces), geometry = new T.BufferGeometry();
  geometry.setAttribute("position", new T.BufferAttribute(vertices, 3));
  geometry.setIndex(new T.BufferAttribute(
    mesh.bytes == 2 ? new Uint16Array(faces) : new Uint32Array(faces), 1));
  geometry.computeVertexNormals();
  return geometry;
}

// Meshcat's viewer in a pane, with a group for our objects.
function openViewer(pane) {
  const viewer = new MeshCat.Viewer(pane), stage = new T.Group();
  const set = (path, name, value) => viewer.set_property(path, name, value);
  set(["Background"], "top_color", [0.985, 0.99, 1]);
  set(["Background"], "bottom_color", [0.86, 0.89, 0.94]);
  set(["Grid"], "visible", false);
  set(["Axes"], "visible", false);
  viewer.set_object(["softdyn"], stage);
  return [viewer, stage];
}

// The websocket to the server of this page; `frame` gets rows of numbers, `news` gets objects.
function openLink(frame, news) {
  const address = new URL("live" + location.search, location.href);  // a proxy may add a path
  address.protocol = location.protocol == "https:" ? "wss:" : "ws:";
  const link = new WebSocket(address);
  link.binaryType = "arraybuffer";
  link.onmessage = ({data}) => {
    if (typeof data == "string") news(JSON.parse(data)); else frame(new Float32Array(data));
  };
  return link;
}

// Turns the camera so that points (z up) fill a part of the window around a shifted middle.
function fitCamera(viewer, points, room, shift) {
  const box = new T.Box3().setFromPoints(points), centre = box.getCenter(new T.Vector3());
  // seen from -y, a little from the side and from above; the camera's frame has y up
  const [turn, rise] = [0.42, 0.2];
  const view = new T.Vector3(
    Math.sin(turn) * Math.cos(rise), Math.sin(rise), Math.cos(turn) * Math.cos(rise));
  const {camera, controls} = viewer, tan = Math.tan(Math.PI / 12);
  const aspect = innerWidth / innerHeight;
  const right = new T.Vector3(Math.cos(turn), 0, -Math.sin(turn));
  const up = new T.Vector3().crossVectors(view, right);
  const seen = points.map(p => new T.Vector3(p.x, p.z, -p.y));
  const middle = new T.Vector3(centre.x, centre.z, -centre.y);
  let distance = 1;
  for (let k = 0; k < 12; k++) {  // find centre and distance at which the points fill the part
    const ends = [Infinity, -Infinity, Infinity, -Infinity];
    for (const p of seen) {
      const d = p.clone().sub(middle), depth = Math.max(distance - d.dot(view), 1e-3);
      const [x, y] = [d.dot(right) / depth, d.dot(up) / depth];
      [ends[0], ends[1]] = [Math.min(ends[0], x), Math.max(ends[1], x)];
      [ends[2], ends[3]] = [Math.min(ends[2], y), Math.max(ends[3], y)];
    }
    middle.addScaledVector(right, (ends[0] + ends[1]) / 2 * distance)
      .addScaledVector(up, (ends[2] + ends[3]) / 2 * distance);
    distance *= Math.max((ends[1] - ends[0]) / (2 * tan * aspect * room[0]),
      (ends[3] - ends[2]) / (2 * tan * room[1]), 0.2);
  }
  middle.addScaledVector(right, -shift[0] * tan * aspect * distance)
    .addScaledVector(up, -shift[1] * tan * distance);
  camera.fov = 30;
  camera.near = distance / 100;
  camera.far = distance * 20;
  controls.target.copy(middle);
  camera.position.copy(middle).addScaledVector(view, distance);
  controls.update();
  viewer.set_dirty();
}

