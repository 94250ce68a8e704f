// Shows recording.rrd in Rerun's web viewer. The address may end in "#at=42900000&show=moment-1": the time at which the
// viewer pauses, in ns of the recording's timeline, and the name of two files for that moment: moment-1.rbl, a layout,
// and moment-1.rrd, the same layout and data to add to the recording. "of=ball" shows ball.rrd, one of several
// recordings, with its layout ball.rbl.
"use strict";

const PATIENCE = 200; // ms between two checks of the viewer's state
const UNANSWERED = 5000; // ms after which a request to the viewer is repeated
const progress = document.getElementById("progress");

// Rerun's viewer asks its makers' hosts for news, and sends them usage data. Here, no request leaves this origin, so
// recordings stay private. The page's security policy would also refuse such requests, with an error in the console for
// each.
const fetchAnything = window.fetch.bind(window);
window.fetch = (request, options) => {
  const url = new URL(request instanceof Request ? request.url : request, location.href);
  const ours = url.origin === location.origin;
  return ours ? fetchAnything(request, options) : Promise.resolve(new Response(null, { status: 204 }));
};

// The colours of a recording are for a dark background, but the viewer takes its theme from the browser: in a light
// theme, coloured words would be on light grey. The viewer is therefore told that the browser's theme is dark.
const askAnything = window.matchMedia.bind(window);
window.matchMedia = (query) => {
  const scheme = /prefers-color-scheme:\s*(\w+)/.exec(query);
  return askAnything(scheme === null ? query : scheme[1] === "dark" ? "all" : "not all");
};

function say(text) {
  progress.textContent = text;
}

async function got(name) {
  const response = await fetch(name);
  if (!response.ok) throw new Error(`${name}: ${response.status} ${response.statusText}`);
  return response;
}

async function download(name) {
  const response = await got(name);
  const total = Number(response.headers.get("content-length"));
  const parts = [];
  let loaded = 0;
  for (const reader = response.body.getReader(); ; ) {
    const { done, value } = await reader.read();
    if (done) return new Blob(parts);
    parts.push(value);
    loaded += value.length;
    say(`Loading the viewer …${loaded <= total ? ` ${Math.floor((100 * loaded) / total)} %` : ""}`);
  }
}

// Some hosts unpack a .gz file before they send it to the browser.
async function unpacked(blob) {
  const [first, second] = new Uint8Array(await blob.slice(0, 2).arrayBuffer());
  if (first !== 0x1f || second !== 0x8b) return blob.arrayBuffer();
  return new Response(blob.stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
}

// The viewer is driven by Rerun's protocol buffers, viewer_control.proto.
function varint(value) {
  const bytes = [];
  for (let rest = BigInt.asUintN(64, value); ; rest >>= 7n) {
    if (rest < 128n) return [...bytes, Number(rest)];
    bytes.push(Number(rest & 127n) | 128);
  }
}

function message(field, content) {
  return [(field << 3) | 2, ...varint(BigInt(content.length)), ...content];
}

function pauseAt(viewer, nanoseconds) {
  const timeline = message(2, message(1, new TextEncoder().encode("sim_time")));
  const time = message(3, [1 << 3, ...varint(nanoseconds)]);
  const paused = [5 << 3, 1];
  return viewer.viewer_control(new Uint8Array(message(6, [...timeline, ...time, ...paused])));
}

// Counts the recordings that are open and the sources that are still loading: fields 3 and 7 of the viewer's state.
function opened(viewer) {
  const bytes = viewer.viewer_state();
  const counts = { 3: 0, 7: 0 };
  let place = 0;
  function number() {
    for (let value = 0, unit = 1; ; unit *= 128) {
      const byte = bytes[place++];
      value += (byte & 127) * unit;
      if (byte < 128) return value;
    }
  }
  while (place < bytes.length) {
    const tag = number();
    if (tag >> 3 in counts) counts[tag >> 3] += 1;
    const wire = tag & 7;
    if (wire === 5 || wire === 1) place += wire === 5 ? 4 : 8;
    else {
      const value = number();
      if (wire === 2) place += value;
    }
  }
  return { recordings: counts[3], loading: counts[7] };
}

const pause = () => new Promise((resolve) => setTimeout(resolve, PATIENCE));

const wanted = new URLSearchParams(location.hash.slice(1));
const time = /^-?\d+$/.test(wanted.get("at")) ? BigInt(wanted.get("at")) : null;
const named = (key) => (/^[\w-]+$/.test(wanted.get(key)) ? wanted.get(key) : null);
const moment = named("show");
const recording = `${named("of") ?? "recording"}.rrd`;
const layout = named("of") ?? "layout";

// The viewer uses new data in its next frame, which it may never paint without an event: after a reload on a busy
// machine, it waited for the mouse to move. It repaints when its page is shown.
function wake() {
  window.dispatchEvent(new Event("pageshow"));
}

// Sends a small file to the viewer, which continues to show its recording.
async function send(viewer, name) {
  const bytes = new Uint8Array(await (await got(name)).arrayBuffer());
  viewer.open_channel(name, name);
  viewer.send_rrd_to_channel(name, bytes);
  viewer.close_channel(name);
  wake();
  await pause();
}

async function load(viewer) {
  await send(viewer, `${moment ?? layout}.rbl`); // sent first, since otherwise the viewer would make a layout of its own
  viewer.add_receiver(new URL(recording, location.href).href);
  for (let there = false; !there; ) {
    wake();
    await pause();
    const { recordings, loading } = opened(viewer);
    // the viewer refuses a time until the recording has times, so this is repeated until the recording is loaded
    there = recordings > 0 && (time === null || (await goThere(viewer))) && loading === 0;
  }
  if (moment !== null) await send(viewer, `${moment}.rrd`); // sent last, since the recording contains its own layout
}

async function goThere(viewer) {
  try {
    const late = new Promise((_, reject) => setTimeout(reject, UNANSWERED));
    await Promise.race([pauseAt(viewer, time), late]);
    return true;
  } catch {
    return false;
  }
}

function watch(viewer) {
  if (viewer.has_panicked()) {
    document.getElementById("viewer").remove();
    document.body.append(progress);
    say(`The viewer has failed: ${viewer.panic_message()}. Reload the page to try again.`);
    return;
  }
  setTimeout(watch, 1000, viewer);
}

async function main() {
  if (location.protocol === "file:") {
    say("A browser does not run the viewer from a file. In this folder: python3 -m http.server --bind 127.0.0.1, then open http://127.0.0.1:8000/");
    return;
  }
  if (typeof DecompressionStream === "undefined") {
    say("This browser is too old for the viewer: it needs Chrome 91, Firefox 113 or Safari 16.4, or a later one.");
    return;
  }
  const code = await unpacked(await download("re_viewer.wasm.gz"));
  say("Starting the viewer …");
  await wasm_bindgen({ module_or_path: code });
  const viewer = new wasm_bindgen.WebHandle({ url: [], hide_welcome_screen: true, enable_history: false, persist: false });
  await viewer.start(document.getElementById("viewer"));
  say("");
  watch(viewer);
  await load(viewer);
  document.body.dataset.state = "loaded";
}

window.addEventListener("hashchange", () => location.reload());

main().catch((error) => {
  console.error(error);
  say(`The viewer cannot be shown: ${error.message ?? error}`);
});
