(() => {
  "use strict";
  const source = document.getElementById("surfaces");
  const canvas = document.getElementById("view");
  if (!source || !canvas) return;
  const { surfaces, zones, storeys } = JSON.parse(source.textContent);
  const label = document.getElementById("label");
  const select = document.getElementById("storey");
  const context = canvas.getContext("2d");
  // Kinds of surfaces: wall, roof, floor, ceiling, window, door, shading, photovoltaic.
  const colors = ["grid", "line", "grid", "grid", "cool", "series-6", "panel", "series-2"];
  let azimuth = -0.6, elevation = 0.5, zoom = 1, drawn = [], marked = -1;
  const points = surfaces.flatMap((s) => s.corners);
  const low = [0, 1, 2].map((i) => Math.min(...points.map((p) => p[i])));
  const high = [0, 1, 2].map((i) => Math.max(...points.map((p) => p[i])));
  const center = low.map((v, i) => (v + high[i]) / 2);
  const size = Math.hypot(...low.map((v, i) => high[i] - v)) || 1;

  const color = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  // Surfaces are drawn layer by layer, within a layer from far to near; -1: not at all. Of the whole building only
  // what is outside and faces the viewer is drawn, and of the highest storey of a cut building what is within it, too.
  const layer = (s, isFacing) => {
    const top = Number(select.value), storey = s.zone < 0 ? -1 : zones[s.zone].storey;
    if (s.zone < 0) return top < storeys.length ? -1 : 0;
    if (top >= storeys.length || storey < top) return s.exposed && isFacing ? 0 : -1;
    if (storey > top || s.kind === 1 || s.kind === 3) return -1;
    if (s.kind === 2 && s.corners[0][2] > storeys[top] + 1) return -1; // of a plenum above
    return s.kind === 2 ? 1 : s.exposed ? (isFacing ? 4 : 2) : 3;
  };
  const project = ([x, y, z]) => {
    const [dx, dy, dz] = [x - center[0], y - center[1], z - center[2]];
    const right = dx * Math.cos(azimuth) + dy * Math.sin(azimuth);
    const away = dy * Math.cos(azimuth) - dx * Math.sin(azimuth);
    const up = dz * Math.cos(elevation) + away * Math.sin(elevation);
    const scale = (zoom * Math.min(canvas.width, canvas.height * 1.6)) / size;
    return [
      canvas.width / 2 + right * scale, canvas.height / 2 - up * scale,
      away * Math.cos(elevation) - dz * Math.sin(elevation),
    ];
  };
  const draw = () => {
    const ratio = window.devicePixelRatio || 1;
    canvas.width = canvas.clientWidth * ratio;
    canvas.height = canvas.clientHeight * ratio;
    context.lineWidth = ratio * 0.7;
    drawn = surfaces.map((surface) => {
      const corners = surface.corners.map(project);
      const signed = corners.reduce((sum, p, i) => {
        const q = corners[(i + 1) % corners.length];
        return sum + p[0] * q[1] - q[0] * p[1];
      }, 0);
      const depth = corners.reduce((sum, p) => sum + p[2], 0) / corners.length;
      const path = new Path2D();
      corners.forEach((p, i) => (i ? path.lineTo(p[0], p[1]) : path.moveTo(p[0], p[1])));
      path.closePath();
      // Windows and doors lie in the plane of their wall and are drawn after it.
      return { surface, path, layer: layer(surface, signed < 0), depth: depth - (surface.kind === 4 || surface.kind === 5 ? size * 0.004 : 0) };
    }).filter((d) => d.layer >= 0);
    drawn.sort((a, b) => a.layer - b.layer || b.depth - a.depth);
    const edge = color("muted"), zone = color("series-4"), fills = colors.map(color);
    for (const { surface, path, layer } of drawn) {
      const isMarked = marked >= 0 && surface.zone === marked;
      context.globalAlpha = surface.kind === 6 ? 0.5 : layer === 4 ? 0.35 : 1;
      context.fillStyle = isMarked && surface.kind !== 4 ? zone : fills[surface.kind];
      context.fill(path);
      context.globalAlpha = 1;
      context.strokeStyle = edge;
      context.stroke(path);
    }
  };
  const mark = (zone, text) => {
    if (zone !== marked) { marked = zone; draw(); }
    label.textContent = text;
  };
  const point = (event) => {
    const box = canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
    const [x, y] = [(event.clientX - box.left) * ratio, (event.clientY - box.top) * ratio];
    const hit = [...drawn].reverse().find((d) => context.isPointInPath(d.path, x, y));
    const zone = hit ? hit.surface.zone : -1;
    mark(zone, zone < 0 ? "" : `${zones[zone].name}: ${zones[zone].area} m²`);
  };
  let from = null;
  canvas.addEventListener("pointerdown", (event) => { from = event; canvas.setPointerCapture(event.pointerId); });
  canvas.addEventListener("pointerup", () => { from = null; });
  canvas.addEventListener("pointermove", (event) => {
    if (!from) { point(event); return; }
    turn((event.clientX - from.clientX) * 0.01, (event.clientY - from.clientY) * 0.01);
    from = event;
  });
  const turn = (right, up) => {
    azimuth -= right;
    elevation = Math.max(-1.5, Math.min(1.5, elevation + up));
    draw();
  };
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom = Math.max(0.3, Math.min(20, zoom * Math.exp(-event.deltaY * 0.001)));
    draw();
  }, { passive: false });
  const keys = {
    ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1],
  };
  canvas.addEventListener("keydown", (event) => {
    if (event.key in keys) turn(...keys[event.key]);
    else if (event.key === "+" || event.key === "-") { zoom *= event.key === "+" ? 1.2 : 1 / 1.2; draw(); }
    else return;
    event.preventDefault();
  });
  select.addEventListener("change", draw);
  window.addEventListener("resize", draw);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  draw();
})();
