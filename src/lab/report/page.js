"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const { t, gap, change, lanes, cause, causes, probability, state, states, health, healths, latency, taps, alarms } = data;
  const byId = (id) => document.getElementById(id);
  const charts = byId("charts"), reading = byId("reading");
  const first = t[0], last = t[t.length - 1], whole = Math.max(last - first, 1e-3);
  const LEAST = Math.min(whole, 1);
  let view = [first, first + whole];

  const svgOf = (name, attributes, parent, text) => {
    const node = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const key in attributes) node.setAttribute(key, attributes[key]);
    if (text !== undefined) node.textContent = text;
    if (parent) parent.append(node);
    return node;
  };
  const shown = (n, digits) => (n === null || n === undefined ? "–" : n.toFixed(digits).replace(/^-(0\.?0*)$/, "$1"));
  const seconds = (n, step) => n.toFixed(step < 0.1 ? 2 : step < 1 ? 1 : 0) + " s";
  const niceStep = (span, count) => {
    const rough = span / count, power = 10 ** Math.floor(Math.log10(rough));
    return power * [1, 2, 5, 10].find((m) => m * power >= rough * 0.999);
  };
  // The first line at or after a time.
  const at = (time) => {
    let low = 0, high = t.length;
    while (low < high) { const mid = (low + high) >> 1; t[mid] < time ? (low = mid + 1) : (high = mid); }
    return low;
  };
  const holdsUntil = (i) => (i + 1 < t.length ? t[i + 1] : last);

  // A chart of the lines in [from, to]: what it holds is given as rows, from the top.
  function draw(parent, [from, to], rows) {
    // What is not on the screen, but will be on paper, takes the width of what is.
    const width = Math.max(parent.clientWidth || charts.clientWidth, 240), left = width < 560 ? 82 : 100, right = 8;
    const x = (time) => left + ((time - from) / (to - from)) * (width - left - right);
    const height = rows.reduce((sum, row) => sum + row.height + 42, 0) + 16;
    const svg = svgOf("svg", { viewBox: `0 0 ${width} ${height}`, height, "aria-hidden": "true" });
    const clip = `clip${draw.count = (draw.count || 0) + 1}`;
    const box = svgOf("clipPath", { id: clip }, svgOf("defs", {}, svg));
    svgOf("rect", { x: left, y: 0, width: width - left - right, height }, box);
    const inside = svgOf("g", { "clip-path": `url(#${clip})` });
    const begin = Math.max(at(from) - 1, 0), end = Math.min(at(to) + 1, t.length);
    const step = niceStep(to - from, width < 560 ? 4 : 9);
    for (let k = Math.ceil(from / step - 1e-9); k * step <= to + 1e-9; k++) {
      svgOf("line", { x1: x(k * step), x2: x(k * step), y1: 20, y2: height - 20, class: "grid" }, svg);
      svgOf("text", { x: x(k * step), y: height - 4, "text-anchor": "middle" }, svg, seconds(k * step, step));
    }
    svg.append(inside);
    alarms.forEach(([a, b, name]) => {
      if (b < from || a > to) return;
      svgOf("rect", { x: x(a), y: 20, width: Math.max(x(b) - x(a), 1), height: height - 40, class: `alarm fill ${name}` }, inside);
      svgOf("line", { x1: x(a), x2: x(a), y1: 20, y2: height - 20, class: `shift ${name}` }, inside);
    });
    let top = 0;
    for (const row of rows) {
      svgOf("text", { x: 0, y: top + 14, class: "title" }, svg, row.title);
      top += 26;
      row.draw({ svg, inside, x, top, left, right: width - right, begin, end, height: row.height });
      top += row.height + 16;
    }
    // Flags on top of everything; those too close to the one before are left out, the table has them all.
    let free = -Infinity;
    alarms.forEach(([a, , name], k) => {
      if (a < from || a > to || x(a) < free) return;
      free = x(a) + 20;
      const flag = svgOf("g", { class: `flag ${name}` }, svg);
      svgOf("rect", { x: x(a) - 9, y: 2, width: 18, height: 17, rx: 4, class: "fill" }, flag);
      svgOf("text", { x: x(a), y: 14.5, "text-anchor": "middle" }, flag, k + 1);
    });
    parent.replaceChildren(svg);
    return { svg, x, time: (px) => from + ((px - left) / (width - left - right)) * (to - from), left, right: width - right, height };
  }

  // Curves over a shared scale; a line without a number leaves a hole.
  function curves(title, height, list, { threshold, digits, unit = "" }) {
    return {
      title, height,
      draw({ svg, inside, x, top, left, right, begin, end }) {
        let low = 0, high = threshold ? 1.2 : 1e-9;
        for (const { values } of list)
          for (let i = begin; i < end; i++)
            if (values[i] !== null) { low = Math.min(low, values[i]); high = Math.max(high, values[i]); }
        const step = niceStep(high - low, Math.max(2, Math.floor(height / 34)));
        low -= low < 0 ? (high - low) * 0.06 : 0;
        high += (high - low) * 0.04;
        const y = (v) => top + height - ((v - low) / (high - low)) * height;
        for (let k = Math.ceil(low / step); k * step <= high; k++) {
          const v = k * step;
          svgOf("line", { x1: left, x2: right, y1: y(v), y2: y(v), class: "grid" }, svg);
          svgOf("text", { x: left - 8, y: y(v) + 4, "text-anchor": "end" }, svg, shown(v, Math.max(0, -Math.floor(Math.log10(step) + 1e-9))) + unit);
        }
        svg.append(inside);
        if (threshold) {
          svgOf("line", { x1: left, x2: right, y1: y(1), y2: y(1), class: "threshold" }, inside);
          svgOf("text", { x: right - 2, y: y(1) - 5, "text-anchor": "end", class: "threshold-name" }, inside, "alarm threshold");
        }
        list.forEach(({ values, colour, dash, name }, k) => {
          let path = "", pen = false;
          for (let i = begin; i < end; i++) {
            if (values[i] === null) { pen = false; continue; }
            path += `${pen ? "L" : "M"}${x(t[i]).toFixed(1)} ${y(values[i]).toFixed(1)}`;
            if (!pen) path += "h.01";
            pen = true;
          }
          const line = svgOf("path", { d: path, class: list.length > 1 || !threshold ? "curve thin" : "curve" }, inside);
          if (colour) line.style.stroke = colour;
          if (dash) line.setAttribute("stroke-dasharray", dash);
          if (name) {
            const place = Math.max(left, 110) + k * Math.min(110, (right - Math.max(left, 110)) / list.length);
            const sample = svgOf("line", { x1: place, x2: place + 22, y1: top - 12, y2: top - 12, class: "curve" }, svg);
            if (colour) sample.style.stroke = colour;
            if (dash) sample.setAttribute("stroke-dasharray", dash);
            svgOf("text", { x: place + 28, y: top - 8 }, svg, name.length > 12 ? name.slice(0, 11) + "…" : name);
          }
        });
      },
    };
  }

  // One row a name that occurs, so that no colour is needed to tell them apart; a line without a name leaves a hole.
  function strips(title, names, values, colour) {
    const occurring = names.map((_, k) => k).filter((k) => values.includes(k));
    return {
      title, height: 20 * occurring.length,
      draw({ svg, inside, x, top, left, begin, end }) {
        occurring.forEach((k, row) => {
          svgOf("text", { x: left - 8, y: top + 20 * row + 14, "text-anchor": "end" }, svg, names[k]);
        });
        svg.append(inside);
        for (let i = begin; i < end; ) {
          let next = i + 1;
          while (next < end && values[next] === values[i]) next++;
          const until = next < t.length ? t[next] : last;
          if (values[i] !== null)
            svgOf("rect", {
              x: x(t[i]), y: top + 20 * occurring.indexOf(values[i]) + 3, height: 14, rx: 2,
              width: Math.max(x(until) - x(t[i]), 2), class: `fill ${colour(values[i])}`,
            }, inside);
          i = next;
        }
      },
    };
  }
  const stateRow = strips("State", states, state, (k) => states[k]);
  const causeRow = strips("Likely cause", causes, cause, () => "cause");
  const healthRow = {
    title: health.some((h) => h !== 0) ? "Health: frames that could not be judged" : "Health: every frame was judged",
    height: 16,
    draw({ svg, inside, x, top, left, right, begin, end }) {
      svgOf("line", { x1: left, x2: right, y1: top + 8, y2: top + 8, class: "grid" }, svg);
      svg.append(inside);
      for (let i = begin; i < end; i++)
        if (health[i] !== 0) {
          const mark = svgOf("rect", { x: x(t[i]), y: top + 1, width: Math.max(x(holdsUntil(i)) - x(t[i]), 2), height: 14, class: "fill Unavailable" }, inside);
          svgOf("title", {}, mark, healths[health[i]]);
        }
    },
  };
  const dashes = ["", "7 3", "2 3"];
  const known = (values) => values.some((value) => value !== null);
  const scores = known(change)
    ? [{ values: gap, name: "gap" }, { values: change, name: "change", colour: "var(--tap0)", dash: dashes[1] }]
    : [{ values: gap }];
  const scoreRow = (height) => curves(known(change) ? "Scores" : "Gap", height, scores, { threshold: true });
  const lanesRow = curves("Lanes lost, forecast, %", 56, [{ values: lanes.map((share) => (share === null ? null : 100 * share)), colour: "var(--tap0)" }], {});
  // What no line says has no row.
  const causeRows = known(cause) ? [causeRow] : [], lanesRows = known(lanes) ? [lanesRow] : [];
  const gapRow = (height) => curves("Gap by tap", height, taps.map(({ name, gap }, k) => ({
    values: gap, name, colour: `var(--tap${k % 3})`, dash: dashes[k % 3],
  })), {});
  const latencyRow = curves("Latency, ms", 56, [{ values: latency, colour: "var(--quiet)" }], {});

  let drawn;
  function redraw() {
    drawn = draw(charts, view, [scoreRow(170), stateRow, ...causeRows, healthRow, ...lanesRows, gapRow(90), latencyRow]);
    const full = view[0] <= first && view[1] >= first + whole;
    byId("range").textContent = full ? "" : `Shown: ${view[0].toFixed(1)} s to ${view[1].toFixed(1)} s.`;
    for (const id of ["back", "on", "out", "all"]) byId(id).disabled = full;
    byId("in").disabled = view[1] - view[0] <= LEAST * 1.001;
  }
  function show(from, to) {
    const span = Math.min(Math.max(to - from, LEAST), whole);
    const start = Math.min(Math.max((from + to - span) / 2, first), first + whole - span);
    view = [start, start + span];
    redraw();
  }
  const zoom = (factor) => { const mid = (view[0] + view[1]) / 2, half = ((view[1] - view[0]) / 2) * factor; show(mid - half, mid + half); };
  const move = (share) => { const by = (view[1] - view[0]) * share; show(view[0] + by, view[1] + by); };
  const actions = {
    in: () => zoom(0.5), out: () => zoom(2), back: () => move(-0.5), on: () => move(0.5), all: () => show(first, first + whole),
  };
  for (const id in actions) byId(id).addEventListener("click", actions[id]);
  const keys = { "+": "in", "=": "in", "-": "out", ArrowLeft: "back", ArrowRight: "on", 0: "all" };
  charts.addEventListener("keydown", (event) => {
    const id = keys[event.key];
    if (!id || event.ctrlKey || event.metaKey || event.altKey) return;
    actions[id]();
    event.preventDefault();
  });

  const within = (event) => Math.min(Math.max(event.clientX - charts.getBoundingClientRect().left, drawn.left), drawn.right);
  let dragFrom = null, selection = null, cursor = null;
  charts.addEventListener("pointerdown", (event) => {
    if (event.button !== 0 || event.pointerType === "touch") return;
    dragFrom = within(event);
    charts.setPointerCapture(event.pointerId);
  });
  charts.addEventListener("pointermove", (event) => {
    const px = within(event), i = Math.max(0, at(drawn.time(px) + 1e-9) - 1);
    if (!cursor || !cursor.isConnected) cursor = svgOf("line", { y1: 20, y2: drawn.height - 20, class: "cursor" }, drawn.svg);
    cursor.setAttribute("x1", px);
    cursor.setAttribute("x2", px);
    reading.textContent = `${t[i].toFixed(2)} s: ${states[state[i]]}, gap ${shown(gap[i], 2)}` +
      (change[i] === null ? "" : `, change ${shown(change[i], 2)}`) +
      (lanes[i] === null ? "" : `, lanes lost ${shown(100 * lanes[i], 0)} %`) +
      (cause[i] === null ? "" : `, ${causes[cause[i]]} (${shown(100 * probability[i], 0)} %)`) +
      taps.map(({ name, gap }) => `, ${name} ${shown(gap[i], 4)}`).join("") +
      (health[i] ? `, ${healths[health[i]]}` : "");
    if (dragFrom === null) return;
    if (!selection || !selection.isConnected) selection = svgOf("rect", { y: 20, height: drawn.height - 40, class: "selection" }, drawn.svg);
    selection.setAttribute("x", Math.min(px, dragFrom));
    selection.setAttribute("width", Math.abs(px - dragFrom));
  });
  charts.addEventListener("pointerup", (event) => {
    const from = dragFrom, to = within(event);
    dragFrom = null;
    if (from === null) return;
    if (selection) selection.remove();
    if (Math.abs(to - from) > 6) show(drawn.time(Math.min(from, to)), drawn.time(Math.max(from, to)));
  });
  charts.addEventListener("pointercancel", () => { dragFrom = null; if (selection) selection.remove(); });
  charts.addEventListener("pointerleave", () => { reading.textContent = "\u00a0"; if (cursor) cursor.remove(); });

  function drawCloser(box) {
    const from = Number(box.dataset.from), to = Number(box.dataset.to), margin = Math.max(2, (to - from) * 0.25);
    draw(box, [Math.max(first, from - margin), Math.max(Math.min(last, to + margin), first + 1e-3)], [scoreRow(90), stateRow, ...causeRows, ...lanesRows, gapRow(70)]);
  }
  for (const row of document.querySelectorAll("tr.alarm")) {
    const button = row.querySelector("button"), behind = byId(button.getAttribute("aria-controls"));
    row.addEventListener("click", () => {
      behind.hidden = !behind.hidden;
      button.setAttribute("aria-expanded", String(!behind.hidden));
      if (!behind.hidden) drawCloser(behind.querySelector(".closer"));
    });
  }
  const redrawAll = () => {
    redraw();
    for (const box of document.querySelectorAll("tr.behind:not([hidden]) .closer")) drawCloser(box);
  };
  let width = charts.clientWidth;
  window.addEventListener("resize", () => { if (charts.clientWidth !== width) { width = charts.clientWidth; redrawAll(); } });
  window.addEventListener("beforeprint", () => document.querySelectorAll(".closer").forEach(drawCloser));
  redraw();
})();
