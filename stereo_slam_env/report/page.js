"use strict";

// ---- tables: a click (or Enter) on a heading sorts by it, unknown values stay at the end
for (const table of document.querySelectorAll("table.sortable")) {
  const heads = [...table.tHead.rows[table.tHead.rows.length - 1].cells];
  const value = (row, column) => row.cells[column].dataset.value ?? row.cells[column].textContent.trim();
  const isNumber = text => text !== "" && !isNaN(text);
  const sort = (head, column) => {
    const up = head.getAttribute("aria-sort") !== "ascending";
    const rows = [...table.tBodies[0].rows].sort((a, b) => {
      const [x, y] = [value(a, column), value(b, column)];
      if (x === "" || y === "") return (x === "") - (y === "");
      const order = isNumber(x) && isNumber(y) ? x - y : x.localeCompare(y, undefined, {numeric: true});
      return up ? order : -order;
    });
    heads.forEach(other => other.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", up ? "ascending" : "descending");
    table.tBodies[0].append(...rows);
  };
  heads.forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...[...head.childNodes].filter(node => !node.querySelector?.("a")));
    head.prepend(button);
    button.addEventListener("click", () => sort(head, column));
  });
}

addEventListener("beforeprint", () => document.querySelectorAll("details").forEach(part => { part.open = true; }));

// ---- figures: the drawing becomes a chart when it comes into sight
const charts = new Map();  // figure -> {specification, hidden, element}

function coloured(specification) {
  const style = getComputedStyle(document.documentElement);
  const paint = (_, name) => style.getPropertyValue(name).trim();
  const walk = value => {
    if (typeof value === "string") return value.includes("var(--") ? value.replace(/var\((--[\w-]+)\)/g, paint) : value;
    if (Array.isArray(value)) return typeof value[0] === "number" ? value : value.map(walk);
    if (value && typeof value === "object") {
      return Object.fromEntries(Object.entries(value).map(([key, inner]) => [key, walk(inner)]));
    }
    return value;
  };
  const {data, layout} = walk(specification);
  layout.font = {family: getComputedStyle(document.body).fontFamily};
  const label = {bgcolor: style.getPropertyValue("--card").trim(), bordercolor: style.getPropertyValue("--grid").trim()};
  layout.hoverlabel = {...label, font: {color: style.getPropertyValue("--ink").trim(), size: 13}, namelength: -1};
  layout.modebar = {bgcolor: "rgba(0,0,0,0)", color: style.getPropertyValue("--muted").trim(),
    activecolor: style.getPropertyValue("--ink").trim()};
  return {data, layout};
}

function draw(chart) {
  const {data, layout} = coloured(chart.specification);
  for (const trace of data) if (chart.hidden.has(trace.name)) trace.visible = false;
  layout.annotations = layout.annotations.filter(note => !chart.hidden.has(note.name));
  layout.uirevision = "kept";  // zoom survives a change of colours or series
  layout.height = Math.round(chart.element.parentElement.clientWidth / layout.meta.aspect);
  layout.dragmode = matchMedia("(pointer: coarse)").matches ? false : "zoom";
  return Plotly.react(chart.element, data, layout, {
    responsive: false, displaylogo: false, modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"],
  });
}

function keys(chart) {
  const {series} = chart.specification.layout.meta;
  const list = document.createElement("div");
  if (series.length < 2) return list;
  list.className = "keys";
  list.setAttribute("role", "group");
  list.setAttribute("aria-label", "Show or hide series");
  for (const {name, colour} of series) {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = name;
    button.style.setProperty("--colour", colour);
    button.setAttribute("aria-pressed", "true");
    button.addEventListener("click", () => {
      const hide = button.getAttribute("aria-pressed") === "true";
      chart.hidden[hide ? "add" : "delete"](name);
      button.setAttribute("aria-pressed", String(!hide));
      draw(chart);
    });
    list.append(button);
  }
  return list;
}

function enliven(figure) {
  const specification = JSON.parse(figure.querySelector("script.chart-data").textContent);
  const element = document.createElement("div");
  element.className = "chart";
  const stage = figure.querySelector(".stage");
  const chart = {specification, element, hidden: new Set()};
  charts.set(figure, chart);
  stage.append(element);
  draw(chart).then(() => {
    figure.prepend(keys(chart));
    figure.classList.add("live");
  });
}

if (window.Plotly) {
  const visible = new Set(), stale = new Set();
  const watch = new IntersectionObserver(entries => {
    for (const {isIntersecting, target} of entries) {
      visible[isIntersecting ? "add" : "delete"](target);
      if (!isIntersecting) continue;
      if (!charts.has(target)) enliven(target);
      else if (stale.delete(target)) draw(charts.get(target));
    }
  }, {rootMargin: "600px"});
  for (const script of document.querySelectorAll("script.chart-data")) watch.observe(script.parentElement);
  // Charts out of sight wait until they come into it.
  const redraw = () => charts.forEach((chart, figure) => visible.has(figure) ? draw(chart) : stale.add(figure));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  let pending;
  addEventListener("resize", () => { clearTimeout(pending); pending = setTimeout(redraw, 150); });
}
