// The page at GET /: upload a clip, follow its job, look at the avatar. It uses the public API and nothing else.
"use strict";

const $ = (id) => document.getElementById(id);
const VIEWS = 24;

// ---- the API -------------------------------------------------------------------------------------------------------

class Problem extends Error {
  constructor(problem, retryAfter) {
    super(problem.detail || problem.title || "the server cannot be reached");
    this.problem = problem;
    this.waitSecs = Number(retryAfter) || 2;
  }
}

function headers(more = {}) {
  const key = $("key").value.trim();
  // A browser sends no other header, and says no more than that it could not.
  if (!/^[\x21-\x7e]*$/.test(key)) throw new Problem({ title: "This is no API key", expected: "letters without accents, digits and signs, no blanks" });
  return key ? { ...more, authorization: `Bearer ${key}` } : more;
}

async function call(path, options = {}) {
  const sent = headers(options.headers);
  let response;
  try {
    response = await fetch(path, { ...options, headers: sent });
  } catch {
    throw new Problem({});
  }
  if (response.ok) return response;
  const { status } = response;
  const problem = await response.json().catch(() => ({ title: `status ${status}` }));
  if (status === 401) askForKey();
  throw new Problem({ ...problem, status }, response.headers.get("retry-after"));
}

const post = (path, body, signal) =>
  call(path, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(body), signal });

const pause = (problem) => new Promise((resolve) => setTimeout(resolve, 1000 * (problem.waitSecs ?? 2)));

function askForKey() {
  $("key-field").hidden = false;
}

// ---- what went wrong -----------------------------------------------------------------------------------------------

function show(problem, box = $("problem")) {
  box.hidden = !problem;
  box.replaceChildren();
  if (!problem) return;
  const { title, part, frame, expected } = problem.problem || {};
  const lines = [
    title && title !== problem.message ? `${title}: ${problem.message}` : problem.message,
    [part && `part ${part}`, frame !== undefined && `frame ${frame}`].filter(Boolean).join(", "),
    expected && `expected: ${expected}`,
  ];
  for (const line of lines.filter(Boolean)) box.append(element("div", line));
  box.scrollIntoView({ block: "nearest" });
}

function element(name, text, properties = {}) {
  return Object.assign(document.createElement(name), { textContent: text ?? "" }, properties);
}

// ---- upload --------------------------------------------------------------------------------------------------------

// XMLHttpRequest, because fetch does not tell how much has been sent.
function send(form) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("POST", "v1/jobs");
    for (const [name, value] of Object.entries(headers())) request.setRequestHeader(name, value);
    request.responseType = "json";
    request.upload.onprogress = (event) => { $("sent").value = event.loaded / event.total; };
    request.onload = () => {
      if (request.status === 202) return resolve(request.response);
      if (request.status === 401) askForKey();
      reject(new Problem(request.response || { title: `status ${request.status}` }));
    };
    request.onerror = () => reject(new Problem({}));
    request.send(form);
  });
}

function multipart(fields) {
  const options = {};
  for (const name of ["preset", "height_m", "max_frames", "max_side_px", "seed", "texture_px"]) {
    const value = fields.elements[name].value;
    if (value !== "") options[name] = name === "preset" ? value : Number(value);
  }
  if (fields.elements.trust_camera.checked) options.trust_camera = true;
  const form = new FormData();
  for (const name of ["video", "masks", "keypoints", "camera", "poses"]) {
    const file = fields.elements[name].files[0];
    if (file) form.append(name, file);
  }
  form.append("options", JSON.stringify(options));
  return form;
}

$("upload").addEventListener("submit", async (event) => {
  event.preventDefault();
  const button = event.target.querySelector("button");
  show(null);
  $("sent").hidden = false;
  button.disabled = true;
  try {
    const job = await send(multipart(event.target));
    location.hash = job.id;
  } catch (problem) {
    show(problem);
  } finally {
    button.disabled = false;
    $("sent").hidden = true;
  }
});

// ---- a job ---------------------------------------------------------------------------------------------------------

const ENDED = ["succeeded", "failed", "canceled", "expired"];
const HOPELESS = [401, 403, 404, 410]; // who asks again hears the same
let watched = null; // the job that is shown: its id, and what ends all that is asked for it

function leave() {
  watched?.ended.abort();
  watched = null;
  for (const hidden of ["job", "result", "preview", "cancel", "retry", "job-problem", "wish-problem"]) $(hidden).hidden = true;
}

async function watch(id) {
  leave();
  watched = { id, ended: new AbortController() };
  const { signal } = watched.ended;
  for (const emptied of ["state", "stage", "eta", "losses", "warnings"]) $(emptied).textContent = "";
  $("progress").value = 0;
  $("job").hidden = false;
  $("job-id").textContent = id;
  const seen = { last: null }; // the last event's id, of all streams together
  let listed = null; // the state that the list was last asked for with: it may not know this job yet
  while (!signal.aborted) {
    try {
      const job = await (await call(`v1/jobs/${id}`, { signal })).json();
      draw(job);
      if (job.state !== listed) list();
      listed = job.state;
      if (ENDED.includes(job.state)) return;
      if (job.state === "queued") keepPlace(id, signal);
      await follow(id, seen, job.updated_at, signal);
    } catch (problem) {
      if (signal.aborted) return;
      show(problem, $("job-problem"));
      if (HOPELESS.includes(problem.problem?.status)) return;
      await pause(problem); // the server was away or busy
    }
  }
}

let kept = null; // the job whose place is asked for

// The place in the queue is no event of the job's: others move it.
async function keepPlace(id, signal) {
  if (kept === signal) return;
  kept = signal;
  const waits = () => !signal.aborted && $("state").textContent === "queued";
  let wait = {};
  while (waits()) {
    await pause(wait);
    if (!waits()) break;
    try {
      const response = await call(`v1/jobs/${id}`, { signal });
      wait = { waitSecs: Number(response.headers.get("retry-after")) || 2 };
      const job = await response.json();
      if (job.state === "queued" && waits()) draw(job);
    } catch (problem) {
      wait = problem; // whoever follows the events tells what is wrong
    }
  }
  if (kept === signal) kept = null;
}

// Reads the event stream until it ends; fetch instead of EventSource, which cannot send a key. A stream that breaks off throws:
// the next one goes on after the last event of this one. The first begins with all that has been: what the job itself told
// already, as of `known`, is not drawn again.
async function follow(id, seen, known, signal) {
  const headers = seen.last ? { "last-event-id": seen.last } : {};
  const drawn = seen.last ? "" : known;
  const response = await call(`v1/jobs/${id}/events`, { headers, signal });
  if (response.status === 204) return;
  const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
  let text = "";
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    text += value;
    const events = text.split("\n\n");
    text = events.pop();
    for (const event of events) {
      const field = (name) => event.split("\n").find((line) => line.startsWith(`${name}: `))?.slice(name.length + 2);
      if (!field("data")) continue;
      seen.last = field("id") ?? seen.last;
      const data = JSON.parse(field("data"));
      if (data.at <= drawn) continue;
      if (field("event") === "preview") {
        preview(data.url, signal);
        continue;
      }
      if (data.state && ENDED.includes(data.state)) return;
      // Whoever asks for an end hears of progress until the worker has heard of it too.
      const running = $("state").textContent === "canceling" ? "canceling" : "running";
      draw(data.state ? { state: data.state } : { state: running, ...data });
    }
  }
}

function draw(job) {
  // Whatever is written there is read aloud, also where it stood before.
  if ($("state").textContent !== job.state) {
    $("state").textContent = job.state;
    show(null, $("wish-problem"));
  }
  const stage = job.stage && !ENDED.includes(job.state);
  $("stage").textContent = stage ? `${job.stage} ${job.step} of ${job.steps}` : "";
  if (job.queue_position) $("stage").textContent = `number ${job.queue_position} in the queue`;
  $("eta").textContent = job.eta_secs == null ? "" : `about ${Math.ceil(job.eta_secs)} s left`;
  if (job.progress !== undefined) $("progress").value = job.progress;
  const losses = Object.entries(job.losses ?? {}).map(([name, value]) => `${name} ${value.toPrecision(3)}`);
  if (job.losses) $("losses").textContent = losses.join(" · ");
  if (job.clip) $("warnings").replaceChildren(...job.clip.warnings.map((warning) => element("li", warning)));
  $("cancel").hidden = !["queued", "running"].includes(job.state);
  $("retry").hidden = !["failed", "canceled"].includes(job.state);
  if (job.preview_url) preview(job.preview_url, watched.ended.signal);
  show(job.error ? new Problem({ ...job.error, title: `The fit failed (${job.error.type})` }) : null, $("job-problem"));
  if (job.avatar) result(job.avatar);
}

let wished = null; // the newest picture that nobody has asked for yet
let asking = false;

// The avatar as it emerges; call, because an image element cannot send a key. What is missing or late is no fault.
// One at a time: a stream begins with an event for each picture of before, and all have the newest one's address.
async function preview(url, signal) {
  wished = { url, signal };
  if (asking) return;
  asking = true;
  while (wished) {
    const { url, signal } = wished;
    wished = null;
    try {
      const picture = await (await call(url.slice(1), { signal })).blob();
      if (signal.aborted) continue;
      URL.revokeObjectURL($("preview").src);
      $("preview").src = URL.createObjectURL(picture);
      $("preview").hidden = false;
    } catch {
      // The next event brings another.
    }
  }
  asking = false;
}

const wish = (what) => async () => {
  const { id, ended } = watched;
  try {
    await call(`v1/jobs/${id}/${what}`, { method: "POST" });
    if (!ended.signal.aborted) watch(id);
  } catch (problem) {
    // In a box of its own: the next event wipes what was wrong with the last look at the job.
    if (!ended.signal.aborted) show(problem, $("wish-problem"));
  }
};
$("cancel").addEventListener("click", wish("cancel"));
$("retry").addEventListener("click", wish("retry"));

// ---- the avatar ----------------------------------------------------------------------------------------------------

async function result(id) {
  const { signal } = watched.ended;
  try {
    const avatar = await (await patiently(() => call(`v1/avatars/${id}`, { signal }))).json();
    // Links, because a download cannot send a key.
    const askForLinks = () => post(`v1/avatars/${id}/links`, { expires_in_secs: 86400 }, signal);
    const { links } = await (await patiently(askForLinks)).json();
    if (signal.aborted) return;
    $("result").hidden = false;
    const files = Object.entries(links).map(([name, href]) => {
      const item = element("li");
      const page = name.endsWith(".html") ? { target: "_blank", rel: "noopener" } : { download: name };
      item.append(element("a", name, { href: href.slice(1), ...page }));
      return item;
    });
    $("files").replaceChildren(...files);
    $("whole-report").hidden = !links["report.html"];
    $("whole-report").href = links["report.html"]?.slice(1) ?? "";
    $("report").tBodies[0].replaceChildren(...rows(avatar.metrics).map(([name, value]) => row([name, value])));
    await turntable(id, signal, avatar.camera?.rotation);
  } catch (problem) {
    if (!signal.aborted) show(problem, $("job-problem"));
  }
}

// The leaves of the report; of long lists their mean.
function rows(value, name = "") {
  if (value === null || value === undefined) return [];
  if (typeof value === "number") return [[name, Number.isInteger(value) ? `${value}` : value.toPrecision(4)]];
  if (typeof value !== "object") return [[name, `${value}`]];
  if (Array.isArray(value)) {
    const numbers = value.filter((item) => typeof item === "number");
    if (!numbers.length) return [];
    return rows(numbers.reduce((a, b) => a + b, 0) / numbers.length, `${name}, mean of ${numbers.length}`);
  }
  return Object.entries(value).flatMap(([key, item]) => rows(item, name ? `${name} ${key}` : key));
}

function row(cells) {
  const line = element("tr");
  cells.forEach((cell, i) => {
    const data = element("td", typeof cell === "string" ? cell : "");
    if (typeof cell !== "string") data.append(cell);
    if (i && /^[-\d.e]+$/.test(data.textContent)) data.className = "number";
    line.append(data);
  });
  return line;
}

// The body upright before a camera whose y runs down, turned by `angle`: half a turn about the axis between x and z.
// Arms a little down from the T-pose (SMPL's joints 16 and 17).
function standing(angle) {
  const pose = new Array(72).fill(0);
  pose[0] = Math.PI * Math.cos(angle / 2);
  pose[2] = Math.PI * Math.sin(angle / 2);
  pose[3 * 16 + 2] = -0.9;
  pose[3 * 17 + 2] = 0.9;
  return pose;
}

// The same in a world that the clip's camera sees turned by `rotation` (nine numbers, row by row: camera from world): the light stands
// in that world. Quaternions, x y z w: of the rotation, then its inverse after the half turn.
function inWorld(pose, rotation) {
  const [a, b, c, d, e, f, g, h, i] = rotation;
  const [w, x, y, z] = [1 + a + e + i, 1 + a - e - i, 1 - a + e - i, 1 - a - e + i].map((v) => 0.5 * Math.sqrt(Math.max(v, 0)));
  const largest = Math.max(w, x, y, z);
  const q =
    largest === w ? [(h - f) / (4 * w), (c - g) / (4 * w), (d - b) / (4 * w), w]
    : largest === x ? [x, (b + d) / (4 * x), (c + g) / (4 * x), (h - f) / (4 * x)]
    : largest === y ? [(b + d) / (4 * y), y, (f + h) / (4 * y), (c - g) / (4 * y)]
    : [(c + g) / (4 * z), (f + h) / (4 * z), z, (d - b) / (4 * z)];
  const [u, n] = [q.slice(0, 3).map((v) => -v), pose.slice(0, 3).map((v) => v / Math.PI)];
  const cross = [u[1] * n[2] - u[2] * n[1], u[2] * n[0] - u[0] * n[2], u[0] * n[1] - u[1] * n[0]];
  const axis = cross.map((v, k) => v + q[3] * n[k]);
  const angle = 2 * Math.atan2(Math.hypot(...axis), -(u[0] * n[0] + u[1] * n[1] + u[2] * n[2]));
  const length = Math.hypot(...axis) || 1;
  const root = axis.map((v) => (angle * v) / length);
  return [...root, ...pose.slice(3)];
}

async function turntable(id, signal, rotation = [1, 0, 0, 0, 1, 0, 0, 0, 1]) {
  const pictures = new Array(VIEWS);
  $("view").hidden = true;
  const look = () => {
    const wanted = Number($("turn").value);
    for (let away = 0; away < VIEWS; away++) {
      const picture = pictures[(wanted + away) % VIEWS] ?? pictures[(wanted - away + VIEWS) % VIEWS];
      if (!picture) continue;
      $("view").src = picture;
      $("view").hidden = false;
      return;
    }
  };
  $("turn").oninput = look;
  drag($("view"), $("turn"), look);
  const camera = { width: 360, height: 540, fx: 740, fy: 740, cx: 180, cy: 262, rotation };
  const pelvis = [6, 7, 8].map((k) => 3.2 * rotation[k]); // before the camera
  // The quarters first, then what lies between.
  const order = [...Array(VIEWS).keys()].sort((a, b) => rank(a) - rank(b) || a - b);
  for (const [drawn, view] of order.entries()) {
    const pose = inWorld(standing((2 * Math.PI * view) / VIEWS), rotation);
    const picture = await patiently(() => post(`v1/avatars/${id}/renders`, { pose, pelvis, camera }, signal));
    const blob = await picture.blob();
    if (signal.aborted) return;
    pictures[view] = URL.createObjectURL(blob);
    signal.addEventListener("abort", () => URL.revokeObjectURL(pictures[view]), { once: true });
    $("drawn").textContent = drawn + 1 < VIEWS ? `${drawn + 1} of ${VIEWS} sides drawn` : "";
    look();
  }
}

// A worker that is busy with a fit draws between its steps, and a key may ask only so often: asked again for a while.
async function patiently(ask) {
  for (let tries = 1; ; tries++) {
    try {
      return await ask();
    } catch (problem) {
      if (![429, 503].includes(problem.problem?.status) || tries === 10) throw problem;
      await pause(problem);
    }
  }
}

// What no step meets comes last: -1 as an unsigned number.
const rank = (view) => [6, 3, 2].findIndex((step) => view % step === 0) >>> 0;

function drag(image, slider, changed) {
  let from = null;
  image.onpointerdown = (event) => {
    from = { x: event.clientX, view: Number(slider.value) };
    image.setPointerCapture(event.pointerId);
  };
  image.onpointermove = (event) => {
    if (!from) return;
    const turned = Math.round(((event.clientX - from.x) / image.clientWidth) * VIEWS);
    slider.value = (((from.view + turned) % VIEWS) + VIEWS) % VIEWS;
    changed();
  };
  image.onpointerup = image.onpointercancel = () => { from = null; };
}

// ---- the list ------------------------------------------------------------------------------------------------------

async function list() {
  try {
    const { jobs } = await (await patiently(() => call("v1/jobs?limit=20"))).json();
    const lines = jobs.map((job) => {
      const link = element("a", job.id, { href: `#${job.id}` });
      return row([link, job.state, job.options.preset, new Date(job.created_at).toLocaleString()]);
    });
    $("jobs").tBodies[0].replaceChildren(...lines);
  } catch (problem) {
    show(problem);
  }
}

addEventListener("hashchange", () => { location.hash ? watch(location.hash.slice(1)) : leave(); });
$("key").value = sessionStorage.getItem("effigy-key") ?? "";
$("key-field").hidden = !$("key").value;
$("key").addEventListener("change", () => {
  sessionStorage.setItem("effigy-key", $("key").value.trim());
  show(null);
  list();
  if (location.hash) watch(location.hash.slice(1));
});
list();
if (location.hash) watch(location.hash.slice(1));
