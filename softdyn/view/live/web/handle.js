"use strict";
// A handle to move and to turn a target with a mouse, a pen or a finger. All directions and places
// are in the robot's axes, where z is up.

const GRIP = {mouse: 10, pen: 12, touch: 22};  // pixels between a pointer and what it grasps
const GRASPED = "#f5b800";
const STEEP = 0.3;  // sine of the least angle between the view and a plane or line of a drag

/** How far along a line (its direction has length 1) the place is that is nearest to a ray. */
function along(ray, start, way) {
  const apart = new T.Vector3().subVectors(start, ray.origin), cosine = ray.direction.dot(way);
  return (cosine * apart.dot(ray.direction) - apart.dot(way)) / Math.max(1 - cosine ** 2, 1e-6);
}

/** The ray of a pointer in the world. */
function pointerRay({dom_element: pane, camera}, {clientX, clientY}) {
  const box = pane.getBoundingClientRect(), rays = new T.Raycaster();
  rays.setFromCamera({x: 2 * (clientX - box.left) / box.width - 1,
    y: 1 - 2 * (clientY - box.top) / box.height}, camera);
  return rays.ray;
}

/** A function that gives the angle of a ray's place in the plane through a centre. */
function angleAbout(axis, centre) {
  const plane = new T.Plane().setFromNormalAndCoplanarPoint(axis, centre), place = new T.Vector3();
  const flat = new T.Quaternion().setFromUnitVectors(axis, new T.Vector3(0, 0, 1));
  let last = 0;  // kept while the ray misses the plane
  return ray => {
    if (ray.intersectPlane(plane, place)) {
      place.sub(centre).applyQuaternion(flat);
      last = Math.atan2(place.y, place.x);
    }
    return last;
  };
}

/** Distance of a pointer from a line through points of the window (pixels). */
function distance(x, y, points) {
  let least = Infinity;
  points.forEach((b, i) => {
    const a = points[Math.max(i - 1, 0)], [dx, dy] = [b.x - a.x, b.y - a.y];
    const s = ((x - a.x) * dx + (y - a.y) * dy) / (dx * dx + dy * dy || 1);
    const part = Math.max(0, Math.min(1, s));
    least = Math.min(least, Math.hypot(a.x + part * dx - x, a.y + part * dy - y));
  });
  return least;
}

/**
 * A ball with three arrows along the robot's axes, or three rings about the target's own axes.
 *
 * The ball moves in the plane of the robot's axes that faces the camera most, and with Shift along
 * that plane's normal, in depth; an arrow moves the target along itself; a ring turns it.
 */
class Handle {
  /**
   * @param {MeshCat.Viewer} viewer
   * @param {THREE.Object3D} target what is moved and turned, in the robot's axes
   * @param {number} size of the robot (m)
   */
  constructor(viewer, target, size) {
    Object.assign(this, {viewer, target, size});
    this.changed = () => {};  // called after each move and turn
    this.enabled = false;
    this.held = null;  // the part that a pointer holds
    const ball = this.part("ball", [new T.Vector3()], (...press) => this.carry(...press));
    ball.radius = 0.02 * size;
    const axes = AXES.map(([colour, axis]) =>
      ({colour, name: "xyz"[axis], way: new T.Vector3().setComponent(axis, 1)}));
    this.moves = [ball, ...axes.map(axis => this.arrow(axis))];
    this.spins = axes.map(axis => this.ring(axis));
    this.turns = false;
  }

  get dragging() { return this.held !== null; }
  get turns() { return this.turning; }
  set turns(on) {
    this.held = null;
    this.turning = on;
    this.show();
  }
  get parts() { return this.turning ? this.spins : this.moves; }

  // -- what is drawn -----------------------------------------------------------------------

  /** A part: the line by which it is grasped, in the target's axes, and what pressing it begins. */
  part(name, line, begin) { return {name, line, begin, radius: 0, shapes: []}; }

  shape(part, geometry, colour) {
    const made = new T.Mesh(geometry, new T.MeshBasicMaterial(
      {color: colour, opacity: 0.75, transparent: true, depthTest: false}));
    made.renderOrder = 2;
    made.colour = colour;
    part.shapes.push(made);
    this.target.add(made);
    return made;
  }

  arrow({colour, name, way}) {
    const ends = [0.08, 0.2].map(x => way.clone().multiplyScalar(x * this.size));
    const part = this.part(name, ends, (...press) => this.slide(way, ...press));
    lay(this.shape(part, ROD, colour), ...ends, 0.0025 * this.size);
    const cone = new T.ConeGeometry(0.012 * this.size, 0.04 * this.size, 16);
    const head = this.shape(part, cone, colour);
    head.position.copy(ends[1]);
    head.quaternion.setFromUnitVectors(UP, way);
    return part;
  }

  ring({colour, name, way}) {
    const radius = 0.17 * this.size;
    const turn = new T.Quaternion().setFromUnitVectors(new T.Vector3(0, 0, 1), way);
    const line = Array.from({length: 49}, (_, k) => new T.Vector3(radius, 0, 0)
      .applyAxisAngle(new T.Vector3(0, 0, 1), Math.PI * k / 24).applyQuaternion(turn));
    const part = this.part(name, line, (...press) => this.spin(way, radius, ...press));
    const torus = new T.TorusGeometry(radius, 0.003 * this.size, 8, 72);
    this.shape(part, torus, colour).quaternion.copy(turn);
    return part;
  }

  /** Whether it can be grasped; if not, a drag has ended, even if the button is still down. */
  enable(on) {
    this.enabled = on;
    if (!on) this.held = null;
    this.show(this.held);
  }

  /** Draws the parts that can be grasped, the one under the pointer in another colour. */
  show(over = null) {
    for (const part of [...this.moves, ...this.spins]) for (const shape of part.shapes) {
      shape.visible = this.enabled && this.parts.includes(part);
      shape.material.color.set(part == over ? GRASPED : shape.colour);
    }
    this.viewer.dom_element.style.cursor = over ? "grab" : "";
    this.over = over;
    this.viewer.set_dirty();
  }

  // -- the pointer -------------------------------------------------------------------------

  /** The part at a place of the window, or null. */
  at({clientX, clientY, pointerType = "mouse"}) {
    if (!this.enabled || !this.target.visible) return null;
    this.target.updateWorldMatrix(true, false);
    const box = this.viewer.dom_element.getBoundingClientRect(), seen = point => {
      const p = this.target.localToWorld(point.clone()).project(this.viewer.camera);
      return {x: box.left + (p.x + 1) / 2 * box.width, y: box.top + (1 - p.y) / 2 * box.height};
    };
    let [nearest, least] = [null, GRIP[pointerType] || GRIP.mouse];
    const pixel = this.pixel(this.target.position);
    for (const part of this.parts) {
      const d = distance(clientX, clientY, part.line.map(seen)) - part.radius / pixel;
      if (d < least) [nearest, least] = [part, d];
    }
    return nearest;
  }

  /** Grasps the part under the pointer; whether there is one. */
  press(event) {
    const part = this.at(event);
    if (part) this.grasp(part, event);
    return part !== null;
  }

  grasp(part, event) {
    this.held = part;
    this.shift = event.shiftKey;
    this.follow = part.begin(this.ray(event), event);
    this.show(part);
  }

  /** Moves what is held, else marks the part under the pointer. */
  move(event) {
    if (!this.held) {
      const over = event.buttons ? null : this.at(event);
      if (over != this.over) this.show(over);
      return;
    }
    if (event.shiftKey != this.shift) this.grasp(this.held, event);
    this.follow(this.ray(event), event);
    this.changed();
    this.viewer.set_dirty();
  }

  release() {
    if (!this.held) return;
    this.held = null;
    this.show();
  }

  /** The ray of a pointer. */
  ray(event) { return pointerRay(this.viewer, event).applyMatrix4(this.home()); }

  /** From the world's axes to the robot's. */
  home() { return this.target.parent.matrixWorld.clone().invert(); }

  /** The direction in which the camera looks. */
  view() {
    return this.viewer.camera.getWorldDirection(new T.Vector3()).transformDirection(this.home());
  }

  /** Length (m) of a pixel at a place. */
  pixel(place) {
    const {camera, dom_element: pane} = this.viewer;
    const far = this.target.parent.localToWorld(place.clone()).distanceTo(camera.position);
    return 2 * far * Math.tan(camera.fov * Math.PI / 360) / pane.clientHeight;
  }

  // -- drags: each is begun by a press, and returns what a move of the pointer does ----------

  /** In the plane that faces the camera; with Shift along its normal. */
  carry(ray, event) {
    const sizes = this.view().toArray().map(Math.abs);
    const normal = new T.Vector3().setComponent(sizes.indexOf(Math.max(...sizes)), 1);
    if (event.shiftKey) return this.slide(normal, ray, event);
    const from = this.target.position.clone(), start = new T.Vector3(), now = new T.Vector3();
    const plane = new T.Plane().setFromNormalAndCoplanarPoint(normal, from);
    if (!ray.intersectPlane(plane, start)) start.copy(from);
    return to => {
      if (to.intersectPlane(plane, now)) this.target.position.copy(from).add(now).sub(start);
    };
  }

  /** Along a line. */
  slide(way, ray, event) {
    const from = this.target.position.clone(), cosine = this.view().dot(way);
    const move = x => this.target.position.copy(from).addScaledVector(way, x);
    if (1 - cosine ** 2 > STEEP ** 2) {
      const start = along(ray, from, way);
      return to => move(along(to, from, way) - start);
    }
    // the line points at the camera: up is away from it
    const pixel = this.pixel(from) * Math.sign(cosine);
    return (_, {clientY}) => move(pixel * (event.clientY - clientY));
  }

  /** About an axis of its own, by the pointer's angle in the plane of the ring. */
  spin(own, radius, ray) {
    const from = this.target.quaternion.clone(), centre = this.target.position.clone();
    const axis = own.clone().applyQuaternion(from), view = this.view();
    // if the ring is seen from its edge, the pointer moves along its near side
    const near = new T.Vector3().crossVectors(view, axis).normalize();
    const angle = Math.abs(axis.dot(view)) > STEEP ? angleAbout(axis, centre)
      : to => along(to, centre, near) / radius;
    const start = angle(ray);
    return to => this.target.quaternion.setFromAxisAngle(axis, angle(to) - start).multiply(from);
  }
}
