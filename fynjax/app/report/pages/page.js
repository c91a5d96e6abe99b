const HOW = "Double-click: larger (with Shift: all of it). Ctrl and wheel: zoom. Drag: move.";
// Lets `view` show part of `layer`. Panes of one state, in shares of their size, move together.
const zoomable = (view, layer, state) => {
  let held = null;
  view.classList.add("zoomable");
  view.title = HOW;
  state.panes.push(() => {
    layer.style.transform = `translate(${100 * state.x}%, ${100 * state.y}%) scale(${state.scale})`;
    view.classList.toggle("zoomed", state.scale > 1);
  });
  const show = () => {
    state.x = Math.min(0, Math.max(state.x, 1 - state.scale));
    state.y = Math.min(0, Math.max(state.y, 1 - state.scale));
    for (const pane of state.panes) pane();
  };
  const at = e => {
    const box = view.getBoundingClientRect();
    return [(e.clientX - box.left) / layer.offsetWidth, (e.clientY - box.top) / layer.offsetHeight];
  };
  const zoom = (e, wanted) => {
    const next = Math.min(16, Math.max(1, wanted)), [x, y] = at(e);
    state.x = x - (x - state.x) * next / state.scale;
    state.y = y - (y - state.y) * next / state.scale;
    state.scale = next;
    show();
  };
  view.addEventListener("dblclick", e => zoom(e, e.shiftKey ? 1 : 2 * state.scale));
  view.addEventListener("wheel", e => {
    if (!e.ctrlKey && !e.metaKey) return;
    e.preventDefault();
    zoom(e, state.scale * Math.exp(-0.002 * e.deltaY));
  }, {passive: false});
  view.addEventListener("pointerdown", e => {
    if (state.scale === 1) return;
    const [x, y] = at(e);
    held = [x - state.x, y - state.y];
    view.setPointerCapture(e.pointerId);
  });
  view.addEventListener("pointermove", e => {
    if (!held) return;
    const [x, y] = at(e);
    state.x = x - held[0];
    state.y = y - held[1];
    show();
  });
  for (const end of ["pointerup", "pointercancel"]) view.addEventListener(end, () => held = null);
};
const still = () => ({scale: 1, x: 0, y: 0, panes: []});
for (const section of document.querySelectorAll("section")) {
  const together = still();
  for (const picture of section.querySelectorAll(".picture")) {
    const whole = picture.firstElementChild, grounds = picture.querySelectorAll(".ground");
    whole.draggable = false;
    for (const pane of grounds) {  // over each view of the ground lies that part of the picture
      const layer = document.createElement("div"), part = whole.cloneNode();
      const [left, top, wide, high] = ["left", "top", "width", "height"].map(
        side => parseFloat(pane.style[side]) / 100);
      part.alt = "";
      part.style.width = `${100 / wide}%`;
      part.style.left = `${-100 * left / wide}%`;
      part.style.top = `${-100 * top / high}%`;
      layer.append(part);
      pane.append(layer);
      zoomable(pane, layer, together);
    }
    if (grounds.length) continue;
    const view = document.createElement("div");
    view.className = "view";
    picture.replaceWith(view);
    view.append(picture);
    zoomable(view, picture, still());
  }
  if (together.panes.length > 1) {
    const hint = document.createElement("p");
    hint.className = "caption";
    hint.textContent = `All views of the ground move together. ${HOW}`;
    const first = section.querySelector(".ground").closest("figure");
    (first.closest(".views") ?? first).before(hint);
  }
}
for (const views of document.querySelectorAll(".views")) {
  const figures = [...views.children], bar = document.createElement("div");
  bar.className = "choose";
  const choose = chosen => figures.forEach((figure, i) => {
    figure.style.display = i === chosen ? "" : "none";
    bar.children[i].setAttribute("aria-pressed", i === chosen);
  });
  figures.forEach((figure, i) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = figure.dataset.label;
    button.addEventListener("click", () => choose(i));
    bar.append(button);
  });
  views.prepend(bar);
  choose(0);
}
const rows = [...document.querySelectorAll("[data-name]")];
for (const row of rows) for (const enter of [true, false])
  row.addEventListener(enter ? "mouseenter" : "mouseleave", () => {
    for (const other of rows)
      if (other.dataset.name === row.dataset.name) other.classList.toggle("same", enter);
  });
