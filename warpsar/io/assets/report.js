// A click on a picture of a report shows it large. Wheel and buttons zoom, a drag moves, and the axes follow. Panzoom does the moving.
const dialog = document.createElement("dialog");
document.body.append(dialog);

/** Round numbers between two ends, at most `most` of them. */
function ticks(from, to, most) {
  const [low, high] = from < to ? [from, to] : [to, from];
  const least = (high - low) / most;
  const decade = 10 ** Math.floor(Math.log10(least));
  const step = [1, 2, 5, 10].map((n) => n * decade).find((one) => one >= least * (1 - 1e-9));
  const found = [];
  for (let k = Math.ceil(low / step - 1e-3); k * step <= high + 1e-3 * step; k += 1) found.push(Number((k * step).toPrecision(10)));
  return found;
}

function label(axis, [from, to], side) {
  axis.querySelectorAll("i").forEach((old) => old.remove());
  for (const at of ticks(from, to, 7)) {
    const mark = document.createElement("i");
    mark.textContent = at.toString().replace("-", "\u2212");
    mark.style[side] = `${(100 * (at - from)) / (to - from)}%`;
    axis.append(mark);
  }
}

/** The part of an axis that shows, where the picture of `size` pixels is enlarged and moved (panzoom: move, then scale). */
function shown([from, to], size, scale, moved) {
  const at = (pixel) => from + (to - from) * (0.5 + ((pixel - 0.5 * size) / scale - moved) / size);
  return [at(0), at(size)];
}

function enlarge(figure) {
  const image = figure.querySelector("img").cloneNode();
  const plot = figure.querySelector(".plot");
  const bar = document.createElement("div");
  bar.className = "bar";
  const caption = Object.assign(document.createElement("span"), { textContent: image.alt });
  const button = (text, label, action) => {
    const made = Object.assign(document.createElement("button"), { type: "button", textContent: text, ariaLabel: label });
    made.addEventListener("click", action);
    return made;
  };
  let box, frame;
  const ratio = figure.querySelector("img").clientWidth / figure.querySelector("img").clientHeight;
  if (plot) {
    frame = plot.cloneNode(true);
    box = frame.querySelector(".box");
    box.replaceChildren(image);
  } else {
    frame = box = Object.assign(document.createElement("div"), { className: "plain" });
    box.append(image);
  }
  image.removeAttribute("style");
  const width = Math.min(0.9 * Math.min(window.innerWidth, 1400), 0.78 * window.innerHeight * ratio);
  box.style.width = `${width}px`;
  box.style.height = `${width / ratio}px`;
  if (plot) frame.style.gridTemplate = `${width / ratio}px 2.6rem / 3.6rem ${width}px`;
  if (plot) frame.style.width = "max-content";
  else frame.style.width = `${width}px`;
  dialog.replaceChildren(bar, frame);
  dialog.showModal();
  const zoom = Panzoom(image, { contain: "outside", minScale: 1, maxScale: 40, cursor: "move" });
  const relabel = () => {
    if (!plot) return;
    const { x, y } = zoom.getPan();
    const scale = zoom.getScale();
    const ends = (name) => figure.dataset[name].split(" ").map(Number);
    label(frame.querySelector(".along"), shown(ends("along"), box.clientWidth, scale, x), "left");
    label(frame.querySelector(".down"), shown(ends("down"), box.clientHeight, scale, y), "top");
  };
  image.addEventListener("panzoomchange", relabel);
  box.addEventListener("wheel", zoom.zoomWithWheel, { passive: false });
  bar.append(caption, button("+", "Nearer", () => zoom.zoomIn()), button("\u2212", "Farther", () => zoom.zoomOut()),
    button("Whole", "The whole picture", () => zoom.reset()), button("Close", "Close", () => dialog.close()));
  relabel();
}

for (const figure of document.querySelectorAll("figure")) {
  const image = figure.querySelector("img");
  if (!image) continue;
  image.tabIndex = 0;
  image.title = "Click to enlarge";
  image.addEventListener("click", () => enlarge(figure));
  image.addEventListener("keydown", (event) => { if (event.key === "Enter") enlarge(figure); });
}
dialog.addEventListener("click", (event) => { if (event.target === dialog) dialog.close(); });
