// The drawing of the over-correction factor with points that can be dragged. Plain JavaScript, no library.
// Geometry first (the tests call it by itself), then the picture.
"use strict";

const StereomateOverCorrection = (() => {
  // Points are [y, z]: y across the strip, z down from the projection centre O at [0, 0].

  function perpendicularsMeet(one, other) {
    // The perpendiculars to the rays at their points: p . x = |p|^2.
    const area = one[0] * other[1] - one[1] * other[0];
    const r1 = one[0] * one[0] + one[1] * one[1];
    const r2 = other[0] * other[0] + other[1] * other[1];
    if (Math.abs(area) <= 1e-14 * Math.sqrt(r1 * r2)) return null;
    return [(r1 * other[1] - r2 * one[1]) / area, (r2 * one[0] - r1 * other[0]) / area];
  }

  // Everything that is drawn and read off, from points 1, 3 and the corrected point 5.
  function construct(first, second, last) {
    const d = Math.hypot(last[0], last[1]);
    const meeting = perpendicularsMeet(first, second);
    if (meeting === null) return { d, meeting: null, foot: null, a: null, n: NaN, side: "undetermined" };
    const part = (meeting[0] * last[0] + meeting[1] * last[1]) / (d * d);
    const foot = [part * last[0], part * last[1]];
    const a = d * (1 - part);
    const critical = Math.abs(1 - part) < 1e-12;
    const n = critical ? Infinity : d / a;
    const side = critical ? "on" : n > 0 ? "outside" : "inside";
    const centre = [meeting[0] / 2, meeting[1] / 2];
    return { d, a, n, side, meeting, foot, centre, radius: Math.hypot(centre[0], centre[1]) };
  }

  function heightAt(profile, y) {
    // Depth of the terrain profile at y, or null outside it.
    for (let i = 1; i < profile.length; i++) {
      const [y0, z0] = profile[i - 1];
      const [y1, z1] = profile[i];
      if (y >= y0 && y <= y1 && y1 > y0) return z0 + ((z1 - z0) * (y - y0)) / (y1 - y0);
    }
    return null;
  }

  const SVG = "http://www.w3.org/2000/svg";

  function element(name, attributes, parent) {
    const made = document.createElementNS(SVG, name);
    for (const key in attributes) made.setAttribute(key, attributes[key]);
    parent.appendChild(made);
    return made;
  }

  function mount(root) {
    const given = JSON.parse(root.querySelector("script[type='application/json']").textContent);
    const points = given.section.map((point) => point.slice());
    const start = given.section.map((point) => point.slice());
    const profile = given.profile || null;
    const svg = root.querySelector("svg");
    const output = root.querySelector("[data-role='reading']");
    const follow = root.querySelector("[data-role='follow']");
    const reset = root.querySelector("[data-role='reset']");
    const depth = Math.max(...points.map((p) => p[1]), ...(profile || []).map((p) => p[1]));
    const reach = Math.max(...points.map((p) => Math.abs(p[0])), ...(profile || []).map((p) => Math.abs(p[0])), 0.5 * depth);
    const view = { y0: -1.25 * reach, y1: 1.25 * reach, z0: -0.1 * depth, z1: 1.25 * depth };
    const begin = construct(...given.roles.map((row) => points[row]));
    // The whole circle, where that leaves the points their place.
    if (begin.meeting !== null && begin.radius < 1.5 * Math.max(depth, reach)) {
      const room = 1.08 * begin.radius;
      view.y0 = Math.min(view.y0, begin.centre[0] - room);
      view.y1 = Math.max(view.y1, begin.centre[0] + room);
      view.z0 = Math.min(view.z0, begin.centre[1] - room);
      view.z1 = Math.max(view.z1, begin.centre[1] + room);
    }
    const size = view.y1 - view.y0;
    svg.setAttribute("viewBox", [view.y0, view.z0, size, view.z1 - view.z0].join(" "));
    const unit = size / 600;
    const layer = element("g", {}, svg);
    const handles = points.map((_, index) => handle(index));

    function handle(index) {
      const group = element("g", {
        class: "smoc-handle", tabindex: "0", role: "slider", "aria-valuemin": view.y0, "aria-valuemax": view.y1,
      }, svg);
      element("circle", { r: 16 * unit, fill: "transparent" }, group);
      element("circle", { r: 6 * unit, class: "smoc-point" }, group);
      const text = element("text", { y: 24 * unit, "font-size": 17 * unit, class: "smoc-number" }, group);
      text.textContent = given.numbers[index];
      let grip = [0, 0];
      group.addEventListener("pointerdown", (event) => {
        group.setPointerCapture(event.pointerId);
        // Without this the page scrolls under the pointer.
        group.focus({ preventScroll: true });
        event.preventDefault();
        const place = onDrawing(event);
        grip = [points[index][0] - place.x, points[index][1] - place.y];
      });
      group.addEventListener("pointermove", (event) => {
        if (!group.hasPointerCapture(event.pointerId)) return;
        const place = onDrawing(event);
        move(index, place.x + grip[0], place.y + grip[1]);
      });
      group.addEventListener("keydown", (event) => {
        const step = (event.shiftKey ? 10 : 1) * 2 * unit;
        const by = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] }[event.key];
        if (!by) return;
        event.preventDefault();
        move(index, points[index][0] + by[0], points[index][1] + by[1]);
      });
      return group;
    }

    function onDrawing(event) {
      return new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    }

    function move(index, y, z) {
      y = Math.min(Math.max(y, view.y0), view.y1);
      const ground = profile && follow && follow.checked ? heightAt(profile, y) : null;
      points[index] = [y, ground !== null ? ground : Math.min(Math.max(z, 0.05 * depth), view.z1)];
      draw();
    }

    function line(from, to, kind) {
      element("line", { x1: from[0], y1: from[1], x2: to[0], y2: to[1], class: "smoc-" + kind }, layer);
    }

    function label(point, dy, text, kind) {
      const made = element("text", { x: point[0], y: point[1] + dy * unit, "font-size": 15 * unit, class: "smoc-label smoc-text-" + kind }, layer);
      made.textContent = text;
    }

    function draw() {
      while (layer.firstChild) layer.removeChild(layer.firstChild);
      if (profile) {
        const outline = profile.map((p) => p.join(",")).join(" ");
        const last = profile[profile.length - 1];
        element("polygon", { points: `${outline} ${last[0]},${view.z1} ${profile[0][0]},${view.z1}`, class: "smoc-ground" }, layer);
        element("polyline", { points: outline, class: "smoc-terrain" }, layer);
      }
      const [first, second, last] = given.roles.map((row) => points[row]);
      const result = construct(first, second, last);
      if (result.meeting !== null) {
        element("circle", { cx: result.centre[0], cy: result.centre[1], r: result.radius, class: "smoc-circle" }, layer);
      }
      for (const point of points) line([0, 0], point, "ray");
      if (result.meeting !== null) {
        line(first, result.meeting, "perpendicular");
        line(second, result.meeting, "perpendicular");
        line(result.meeting, result.foot, "perpendicular");
        line([0, 0], last, "d");
        line(result.foot, last, "a");
        label(result.meeting, 20, "A" + given.numbers[given.roles[1]], "perpendicular");
        label(result.foot, -10, "F", "circle");
      }
      element("circle", { cx: 0, cy: 0, r: 5 * unit, class: "smoc-centre" }, layer);
      label([0, 0], -12, "O", "centre");
      handles.forEach((group, index) => {
        group.setAttribute("transform", `translate(${points[index][0]} ${points[index][1]})`);
        group.setAttribute("aria-label", `point ${given.numbers[index]}`);
        group.setAttribute("aria-valuenow", points[index][0].toFixed(1));
        group.setAttribute("aria-valuetext", `y ${points[index][0].toFixed(1)} m, z ${points[index][1].toFixed(1)} m`);
      });
      output.textContent = reading(result);
      root.dispatchEvent(new CustomEvent("overcorrection", { detail: { section: points.map((p) => p.slice()), n: result.n } }));
    }

    if (reset) {
      reset.addEventListener("click", () => {
        start.forEach((point, index) => { points[index] = point.slice(); });
        draw();
      });
    }
    draw();
    return { points, move };
  }

  function reading(result) {
    if (result.side === "undetermined") return "Two of the points lie on one ray: there is no over-correction factor.";
    const lengths = `d = ${result.d.toFixed(1)} m, a = ${result.a.toFixed(1)} m`;
    if (result.side === "on") return `${lengths}: on the critical circle, n = ±∞, the tilt is not determined.`;
    const warning = Math.abs(result.n) > 20 ? " Close to the circle: a small error of height changes n very much." : "";
    return `${lengths}, n = d/a = ${result.n.toFixed(3)} (${result.side} the critical circle).${warning}`;
  }

  return { construct, heightAt, mount, reading };
})();
