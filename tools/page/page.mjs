// What somebody sees on the page, in cases that its own server does not make at will. `node page.mjs` runs all and fails with
// the first that is not so.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { JSDOM } from "jsdom";

const web = (file) => readFileSync(new URL(`../../web/${file}`, import.meta.url), "utf8");
const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
// Waits for what must come, however busy the machine is; sleep is for what must not.
async function until(holds, what) {
  for (let tries = 0; tries < 1000; tries++) {
    if (holds()) return;
    await sleep(10);
  }
  assert.fail(`${what} has not come`);
}

const [ONE, TWO] = ["aaaaaaaa-0000-7000-8000-000000000001", "bbbbbbbb-0000-7000-8000-000000000002"];

function answer(body, status = 200, headers = {}) {
  return new Response(JSON.stringify(body), { status, headers: { "content-type": "application/json", ...headers } });
}

const busy = (secs) => answer({ title: "This is more than the key allows", detail: "5 requests a minute" }, 429, { "retry-after": `${secs}` });

// A stream of events that stays open; `send` adds one.
function eventStream() {
  let controller;
  const body = new ReadableStream({ start: (c) => { controller = c; } });
  let id = 0;
  const send = (event, data) =>
    controller.enqueue(new TextEncoder().encode(`id: ${++id}\nevent: ${event}\ndata: ${JSON.stringify(data)}\n\n`));
  return { send, response: new Response(body, { headers: { "content-type": "text/event-stream" } }) };
}

const job = (id, state, more = {}) => ({
  id, state, losses: {}, clip: { warnings: [] }, progress: 0, error: null, avatar: null, updated_at: "2026-01-01T00:00:10.000Z", ...more,
});

// The page at `#hash`, before an API that is a function from path and options to a response.
function open(hash, api) {
  const dom = new JSDOM(web("index.html"), { url: `http://page.test/#${hash}`, runScripts: "outside-only", pretendToBeVisual: true });
  const { window } = dom;
  window.asked = [];
  window.fetch = async (path, options = {}) => {
    window.asked.push(`${options.method ?? "GET"} ${path}`);
    options.signal?.throwIfAborted();
    return path.startsWith("v1/jobs?") ? answer({ jobs: [] }) : api(path, options);
  };
  Object.assign(window, { AbortController, TextDecoderStream });
  window.Element.prototype.scrollIntoView = () => {};
  let pictures = 0;
  Object.assign(window.URL, { createObjectURL: () => `blob:${++pictures}`, revokeObjectURL: () => {} });
  window.eval(web("effigy.js"));
  window.$ = (id) => window.document.getElementById(id);
  return window;
}

const cases = {
  async "what comes late for one job is not shown with another"() {
    let refused = false;
    const page = open(ONE, async (path) => {
      const [id, name] = path.includes(ONE) ? [ONE, "one"] : [TWO, "two"];
      if (path.endsWith("links")) {
        if (id === ONE && !refused) {
          refused = true;
          return busy(1);
        }
        return answer({ links: { [`${name}.glb`]: `/v1/avatars/${id}/${name}.glb` } });
      }
      if (path.endsWith("renders")) return new Response("picture");
      if (path.startsWith("v1/avatars/")) return answer({ metrics: { name } });
      return answer(job(id, "succeeded", { avatar: id }));
    });
    await until(() => refused, "the wish for links");
    page.location.hash = TWO;
    await until(() => page.$("files").textContent === "two.glb" && page.$("drawn").textContent === "" && !page.$("view").hidden, "the second job");
    // What was refused for the first is asked again after a second, if at all.
    await sleep(1500);
    assert.equal(page.$("job-id").textContent, TWO);
    assert.equal(page.$("files").textContent, "two.glb");
    assert.match(page.$("report").textContent, /two/);
    const before = page.$("view").src;
    page.$("turn").value = 6;
    page.$("turn").dispatchEvent(new page.Event("input"));
    assert.notEqual(page.$("view").src, before, "the slider turns the avatar");
  },

  async "sides are drawn in the clip's own world, whichever way its camera sees that"() {
    // The body's axes and place as the camera sees them, from what is asked of the renderer.
    const seen = ({ pose, pelvis, camera }) => {
      const angle = Math.hypot(...pose.slice(0, 3)) || 1e-12;
      const [x, y, z] = pose.slice(0, 3).map((v) => v / angle);
      const [c, s] = [Math.cos(angle), Math.sin(angle)];
      const root = [
        [c + x * x * (1 - c), x * y * (1 - c) - z * s, x * z * (1 - c) + y * s],
        [y * x * (1 - c) + z * s, c + y * y * (1 - c), y * z * (1 - c) - x * s],
        [z * x * (1 - c) - y * s, z * y * (1 - c) + x * s, c + z * z * (1 - c)],
      ];
      const R = [0, 3, 6].map((k) => camera.rotation.slice(k, k + 3));
      const rows = R.map((row) => [0, 1, 2].map((j) => row.reduce((sum, r, k) => sum + r * root[k][j], 0)));
      return [...rows.flat(), ...R.map((row) => row.reduce((sum, r, k) => sum + r * pelvis[k], 0))];
    };
    const views = async (rotation) => {
      const drawn = [];
      const page = open(ONE, async (path, options) => {
        if (path.endsWith("links")) return answer({ links: {} });
        if (path.endsWith("renders")) {
          drawn.push(seen(JSON.parse(options.body)));
          return new Response("picture");
        }
        if (path.startsWith("v1/avatars/")) return answer({ metrics: {}, camera: { rotation } });
        return answer(job(ONE, "succeeded", { avatar: ONE }));
      });
      await until(() => drawn.length === 24, "a side");
      page.close();
      return drawn;
    };
    const upright = await views([1, 0, 0, 0, 1, 0, 0, 0, 1]);
    const aslant = [0.8, -0.6, 0, 0.6 * 0.8, 0.8 * 0.8, -0.6, 0.6 * 0.6, 0.8 * 0.6, 0.8];
    for (const rotation of [[1, 0, 0, 0, -1, 0, 0, 0, -1], [-1, 0, 0, 0, 1, 0, 0, 0, -1], [0, -1, 0, 1, 0, 0, 0, 0, 1], aslant]) {
      const drawn = await views(rotation);
      for (const [k, numbers] of drawn.entries()) {
        numbers.forEach((v, i) => assert.ok(Math.abs(v - upright[k][i]) < 1e-6, `${rotation}: side ${k}: ${numbers}, ${upright[k]}`));
      }
    }
  },

  async "a refused wish stays until the job is in another state"() {
    const events = eventStream();
    const page = open(ONE, async (path) => {
      if (path.endsWith("cancel")) return busy(1);
      return path.endsWith("events") ? events.response : answer(job(ONE, "running"));
    });
    await until(() => !page.$("cancel").hidden, "the running job");
    page.$("cancel").click();
    await until(() => !page.$("wish-problem").hidden, "the refusal");
    events.send("progress", { stage: "pose", step: 1, steps: 2, progress: 0.1, losses: {}, at: "2026-01-01T00:00:11.000Z" });
    await until(() => /pose 1 of 2/.test(page.$("stage").textContent), "the progress");
    assert.equal(page.$("wish-problem").hidden, false);
    assert.match(page.$("wish-problem").textContent, /5 requests a minute/);
    events.send("state", { state: "canceling", at: "2026-01-01T00:00:12.000Z" });
    await until(() => page.$("wish-problem").hidden, "the other state");
  },

  async "the place in the queue stays and moves"() {
    const events = eventStream();
    let place = 3;
    const page = open(ONE, async (path) => {
      if (path.endsWith("events")) return events.response;
      return answer(job(ONE, "queued", { queue_position: place }), 200, { "retry-after": "1" });
    });
    const placed = (place) => () => page.$("stage").textContent === `number ${place} in the queue`;
    await until(placed(3), "the place");
    events.send("state", { state: "queued", at: "2026-01-01T00:00:10.000Z" });
    await sleep(100);
    assert.ok(placed(3)());
    place = 2;
    await until(placed(2), "the next place");
    events.send("state", { state: "running", at: "2026-01-01T00:00:20.000Z" });
    await until(() => page.$("state").textContent === "running", "the beginning");
    assert.equal(page.$("stage").textContent, "");
    const asked = page.asked.length;
    await sleep(1500);
    assert.equal(page.asked.length, asked, "a running job has no place that could be asked for");
  },

  async "what has been is not drawn again"() {
    const events = eventStream();
    const page = open(ONE, async (path) => path.endsWith("events") ? events.response : answer(job(ONE, "running", { progress: 0.5 })));
    await until(() => page.$("state").textContent === "running", "the job");
    const drawn = [];
    new page.MutationObserver(() => drawn.push(page.$("state").textContent)).observe(page.$("state"), { childList: true });
    events.send("state", { state: "queued", at: "2026-01-01T00:00:01.000Z" });
    events.send("progress", { stage: "pose", step: 1, steps: 2, progress: 0.1, losses: {}, at: "2026-01-01T00:00:05.000Z" });
    await sleep(100);
    assert.deepEqual(drawn, []);
    assert.equal(page.$("progress").value, 0.5);
    events.send("progress", { stage: "pose", step: 2, steps: 2, progress: 0.6, losses: {}, at: "2026-01-01T00:00:11.000Z" });
    await until(() => page.$("progress").value === 0.6, "what is new");
  },

  async "a job that was left is not shown, and can be given no wish"() {
    const page = open("", async (path) => path.endsWith("events") ? eventStream().response : answer(job(ONE, "running")));
    page.location.hash = ONE;
    await until(() => !page.$("job").hidden && !page.$("cancel").hidden, "the job");
    page.location.hash = "";
    await until(() => page.$("job").hidden, "the page without it");
    assert.ok(page.$("cancel").hidden);
  },

  async "what can be no key is told as that"() {
    const page = open("", async () => answer({}));
    page.$("key").value = "effigy_\u2026";
    page.$("key").dispatchEvent(new page.Event("change"));
    await until(() => /no API key/.test(page.$("problem").textContent), "the word");
  },
};

for (const [name, run] of Object.entries(cases)) {
  try {
    await run();
  } catch (error) {
    console.error(`${name}: ${error.message}`);
    process.exit(1);
  }
}
console.log(`${Object.keys(cases).length} cases`);
process.exit();
