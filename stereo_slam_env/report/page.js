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

// ---- what is wider than the page says so
const wide = new ResizeObserver(entries => {
  for (const {target} of entries) target.classList.toggle("scrolls", target.scrollWidth > target.clientWidth + 1);
});
for (const part of document.querySelectorAll(".scroll")) wide.observe(part);

addEventListener("beforeprint", () => document.querySelectorAll("details").forEach(part => { part.open = true; }));

// ---- figures: where Vega is part of the page, the drawing becomes a chart when it comes into sight; colours follow the page by CSS
const hint = document.createElement("div");
hint.className = "hint";
hint.hidden = true;
document.body.append(hint);

function say(_, event, item, value) {
  hint.hidden = !value;
  if (!value) return;
  const lines = Object.entries(value).filter(([, text]) => text !== "" && text !== "null");
  hint.replaceChildren(...lines.map(([name, text]) => {
    const line = document.createElement("div");
    line.textContent = name.trim() ? `${name}: ${text}` : text;
    return line;
  }));
  hint.style.left = `${Math.max(4, Math.min(event.pageX + 14, scrollX + innerWidth - hint.offsetWidth - 8))}px`;
  hint.style.top = `${event.pageY + 18}px`;
}

function keys(view, series) {
  const list = document.createElement("div");
  if (series.length < 2) return list;
  const hidden = new Set();
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
      hidden[hide ? "add" : "delete"](name);
      button.setAttribute("aria-pressed", String(!hide));
      view.signal("hidden", [...hidden]).runAsync();
    });
    list.append(button);
  }
  return list;
}

async function enliven(figure) {
  const specification = JSON.parse(figure.querySelector("script.chart-data").textContent);
  const drawing = figure.querySelector(".stage > svg");
  const element = document.createElement("div");
  element.className = "chart";
  element.setAttribute("role", "img");
  element.setAttribute("aria-label", drawing.getAttribute("aria-label"));
  figure.querySelector(".stage").append(element);
  const names = (specification.params ?? []).map(parameter => parameter.name);
  const options = {renderer: "svg", actions: false, defaultStyle: false, tooltip: say};
  const {view} = await vegaEmbed(element, specification, options);
  if (names.includes("live")) await view.signal("live", true).runAsync();
  if (names.includes("hidden")) figure.prepend(keys(view, specification.usermeta?.series ?? []));
  element.querySelector("svg").style.maxWidth = drawing.style.maxWidth;
  figure.view = view;
  figure.classList.add("live");
}

// Fingers scroll the page: without a mouse the drawing stays.
if (window.vegaEmbed && matchMedia("(hover: hover)").matches) {
  const watch = new IntersectionObserver(entries => {
    for (const {isIntersecting, target} of entries) {
      if (!isIntersecting) continue;
      watch.unobserve(target);
      enliven(target);
    }
  }, {rootMargin: "600px"});
  for (const script of document.querySelectorAll("script.chart-data")) watch.observe(script.parentElement);
}
