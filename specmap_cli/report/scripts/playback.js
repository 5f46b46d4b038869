// The slider of time: the robot stands where it was.

const track = unpacked(data.track);
const slider = one("#time");
const robot = one("#robot");
let playing = null;

function unpacked(table) {
  const summed = (steps) => { let sum = 0; return steps.map((step) => (sum += step)); };
  const submaps = table.s.flatMap(([submap, count]) => Array(count).fill(submap));
  return { seconds: summed(table.t).map((tenths) => tenths / 10), x: summed(table.x), y: summed(table.y), turn: table.a, submaps, fit: table.fit, starts: table.starts };
}

function placeAt(seconds) {
  let low = 0, high = track.seconds.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (track.seconds[middle] <= seconds) low = middle; else high = middle - 1;
  }
  const next = Math.min(low + 1, track.seconds.length - 1);
  const span = track.seconds[next] - track.seconds[low];
  const share = span > 0 ? (seconds - track.seconds[low]) / span : 0;
  const between = (values) => values[low] + (values[next] - values[low]) * share;
  const turn = ((track.turn[next] - track.turn[low] + 540) % 360) - 180;
  return { index: low, x: between(track.x), y: between(track.y), turn: track.turn[low] + turn * share };
}

function showTime(seconds, follow = false) {
  const at = placeAt(seconds), submap = track.submaps[at.index];
  robot.removeAttribute("hidden");
  robot.style.setProperty("--x", `${at.x}px`);
  robot.style.setProperty("--y", `${at.y}px`);
  robot.style.setProperty("--turn", `${-at.turn}deg`);
  const log = track.starts.filter((start) => start <= seconds).length - 1;
  const words = [submap >= 0 ? data.names[submap] : "in no submap"];
  if (track.fit && track.fit[at.index] >= 0) words.push(`fit ${track.fit[at.index]} %`);
  if (data.logs.length > 1) words.push(data.logs[Math.max(0, log)]);
  const readout = one("#readout"), time = document.createElement("b");
  time.textContent = clock(seconds);
  readout.replaceChildren(time, ` of ${clock(track.seconds.at(-1))}`, document.createElement("br"), words.join(" · "));
  slider.setAttribute("aria-valuetext", `${clock(seconds)}, ${words.join(", ")}`);
  if (follow && !isSeen([at.x, at.y])) look({ ...view, x: at.x - view.width / 2, y: at.y - view.height / 2 });
}

function seek(seconds) {
  if (!slider) return;
  slider.value = seconds;
  showTime(Number(slider.value), true);
}

function stop() {
  cancelAnimationFrame(playing?.frame);
  clearInterval(playing?.timer);
  playing = null;
  one("#play").textContent = "▶";
  one("#play").setAttribute("aria-label", "Play");
}

function play() {
  const end = track.seconds.at(-1), speed = Math.max(4, end / 60);
  if (Number(slider.value) >= end) slider.value = 0;
  const from = Number(slider.value), start = performance.now();
  const advance = () => {
    const now = Math.min(end, from + ((performance.now() - start) / 1000) * speed);
    seek(now);
    if (now >= end) stop();
  };
  const step = () => {
    advance();
    if (playing) playing.frame = requestAnimationFrame(step);
  };
  playing = {};
  if (calm()) playing.timer = setInterval(advance, 1000); // leaps instead of a motion
  else playing.frame = requestAnimationFrame(step);
  one("#play").textContent = "❚❚";
  one("#play").setAttribute("aria-label", "Pause");
}

if (slider) showTime(0);

slider?.addEventListener("input", () => {
  if (playing) stop();
  showTime(Number(slider.value), true);
});
one("#play")?.addEventListener("click", () => (playing ? stop() : play()));
document.addEventListener("click", (event) => {
  const button = event.target.closest("[data-seek]");
  if (!button) return;
  seek(Number(button.dataset.seek));
  stage.scrollIntoView({ block: "nearest" });
});
