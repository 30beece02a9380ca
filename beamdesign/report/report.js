// Values of the curve nearest to the pointer. Without this script the page lacks nothing that its tables do not tell.
"use strict";
for (const data of document.querySelectorAll("script.readings")) {
  const figure = data.parentElement, svg = figure.querySelector("svg");
  const points = JSON.parse(data.textContent).flatMap(
    (curve) => curve.points.map(([px, py, x, y]) => ({ px, py, x, y, curve })));
  const dot = document.createElementNS("http://www.w3.org/2000/svg", "circle");
  dot.setAttribute("class", "dot");
  dot.setAttribute("r", "3.5");
  const tip = document.createElement("div");
  tip.className = "tip";
  tip.setAttribute("aria-hidden", "true");
  const told = (value) => (Math.abs(value) >= 1e5 || (value !== 0 && Math.abs(value) < 1e-3))
    ? value.toExponential(3) : String(Number(value.toPrecision(4)));
  const line = (label, value) => {
    const [name, unit] = [label.replace(/,[^,]*$/, ""), /,/.test(label) ? label.replace(/^.*, */, "") : ""];
    return `${name}: ${told(value)}${unit ? " " + unit : ""}`;
  };
  const hide = () => { dot.remove(); tip.remove(); };
  svg.addEventListener("pointermove", (event) => {
    const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    let best = null, least = 24 * 24;
    for (const point of points) {
      const away = (point.px - at.x) ** 2 + (point.py - at.y) ** 2;
      if (away < least) { least = away; best = point; }
    }
    if (best === null) { hide(); return; }
    dot.setAttribute("cx", best.px);
    dot.setAttribute("cy", best.py);
    svg.append(dot);
    tip.textContent = [best.curve.name, line(best.curve.x, best.x), line(best.curve.y, best.y)].filter(Boolean).join("\n");
    figure.append(tip);
    const box = figure.getBoundingClientRect();
    const left = event.clientX - box.left + 14, top = event.clientY - box.top + 14;
    tip.style.left = `${Math.max(0, Math.min(left, box.width - tip.offsetWidth))}px`;
    tip.style.top = `${top}px`;
  });
  svg.addEventListener("pointerleave", hide);
}
