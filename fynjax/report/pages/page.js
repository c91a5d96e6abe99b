for (const image of document.querySelectorAll(".picture")) {
  const view = document.createElement("div");
  let scale = 1, x = 0, y = 0, held = null;
  view.className = "view";
  view.title = "Double-click: larger (with Shift: all of it). Ctrl and wheel: zoom. Drag: move.";
  image.replaceWith(view);
  view.append(image);
  image.firstElementChild.draggable = false;
  const show = () => {
    x = Math.min(0, Math.max(x, view.clientWidth * (1 - scale)));
    y = Math.min(0, Math.max(y, view.clientHeight * (1 - scale)));
    image.style.transform = `translate(${x}px, ${y}px) scale(${scale})`;
    view.classList.toggle("zoomed", scale > 1);
  };
  const zoom = (event, wanted) => {
    const next = Math.min(16, Math.max(1, wanted)), at = view.getBoundingClientRect();
    x = event.clientX - at.left - (event.clientX - at.left - x) * next / scale;
    y = event.clientY - at.top - (event.clientY - at.top - y) * next / scale;
    scale = next;
    show();
  };
  view.addEventListener("dblclick", e => zoom(e, e.shiftKey ? 1 : 2 * scale));
  view.addEventListener("wheel", e => {
    if (!e.ctrlKey && !e.metaKey) return;
    e.preventDefault();
    zoom(e, scale * Math.exp(-0.002 * e.deltaY));
  }, {passive: false});
  view.addEventListener("pointerdown", e => {
    if (scale === 1) return;
    held = [e.clientX - x, e.clientY - y];
    view.setPointerCapture(e.pointerId);
  });
  view.addEventListener("pointermove", e => {
    if (held) { x = e.clientX - held[0]; y = e.clientY - held[1]; show(); }
  });
  for (const end of ["pointerup", "pointercancel"]) view.addEventListener(end, () => held = null);
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
