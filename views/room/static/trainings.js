// Trainings: their learning curves beside each other, live while they train, with a report and a node for each; and
// the recordings in their folder, to replay.

import { get, post, toast } from "./api.js";
import { fill, h, openDialog, setAttribute, setText } from "./dom.js";
import { bytes, counted, num, words } from "./format.js";
import { forOperators } from "./session.js";
import { COLORS, chart, swatch } from "./trends.js";
import { address, change, link, view } from "./view.js";

const POLL_MS = 2000;
const CHOSEN = 4;
const count = (value) => num(value, "people");

export class TrainingsPage {
  constructor(root) {
    this.curves = new Map();
    this.content = { runs: [], studies: [], recordings: [], reports: {} };
    this.online = new Set();
    this.started = [];
    this.handlers = { overview: (content) => { this.online = new Set(content.nodes.filter((each) => each.online).map((each) => each.node)); this.showWatched(); }, started: (content) => { this.started = content.nodes; this.showWatched(); } };
    this.empty = h("p", { class: "empty", role: "status" }, "…");
    this.metric = h("select", { id: "metric", onchange: () => change({ metric: this.metric.value }, { replace: true }) });
    this.canvas = h("div", { class: "chart" });
    this.canvas.tip = (plot) => this.tip(plot);
    this.legend = h("ul", { class: "legend", "aria-label": "Lines" });
    this.when = h("span", { class: "muted when" });
    this.rows = h("tbody");
    this.watched = h("ul", { class: "started" });
    this.replayed = h("ul", { class: "started" });
    this.recordings = h("tbody");
    const columns = [["Recording"], ["Training"], ["Size", "", "number"], ["", "Actions"]];
    this.studies = h("div", { class: "stack" });
    const heads = [["", "Curve"], ["Training"], ["State"], ["Algorithm"], ["Steps", "", "number"], ["Reward, last 100 episodes", "", "number"], ["Best evaluation", "", "number"], ["References", "", "number"], ["", "Actions"]];
    this.body = h("div", { class: "stack", hidden: true },
      h("section", { class: "panel", "aria-labelledby": "curves-heading" }, h("h2", { id: "curves-heading" }, "Learning curves"),
        h("div", { class: "row wrap" }, h("label", { for: "metric" }, "Metric"), this.metric, h("span", { class: "grow" }), this.when), this.canvas, this.legend, this.watched),
      h("section", { class: "panel", "aria-labelledby": "runs-heading" }, h("h2", { id: "runs-heading" }, "Trainings"),
        h("div", { class: "scroll runs", tabindex: 0, role: "region", "aria-label": "List of trainings" }, h("table", {}, h("thead", {}, h("tr", {}, heads.map(heading))), this.rows))),
      this.studies);
    this.recordingsPanel = h("section", { class: "panel recordings-panel", hidden: true, "aria-labelledby": "recordings-heading" }, h("h2", { id: "recordings-heading" }, "Recordings"),
      h("p", { class: "muted" }, "A replay is a node that publishes a recording again; it takes no commands."), this.replayed,
      h("div", { class: "scroll runs", tabindex: 0, role: "region", "aria-label": "List of recordings" }, h("table", {}, h("thead", {}, h("tr", {}, columns.map(heading))), this.recordings)));
    fill(root, h("h2", { class: "visually-hidden" }, "Trainings"), this.empty, this.body, this.recordingsPanel);
    this.observer = new ResizeObserver(() => this.draw());
    this.observer.observe(this.canvas);
    this.poll();
  }

  close() {
    this.isClosed = true;
    clearTimeout(this.timer);
    this.observer.disconnect();
    this.plot?.destroy();
  }

  onView() { this.show(); this.load(); }
  redraw() { this.shape = ""; this.draw(); }

  async poll() {
    clearTimeout(this.timer);
    try {
      this.content = await get("/api/trainings");
      if (this.isClosed) return;
      this.show();
      await this.load();
    } catch (error) { this.empty.hidden = false; setText(this.empty, error.message); }
    if (!this.isClosed) this.timer = setTimeout(() => this.poll(), POLL_MS);
  }

  /** Names of the trainings whose curves the address asks for; by default the first ones. */
  chosen() {
    const { runs } = view();
    const names = runs === undefined ? this.content.runs.slice(0, CHOSEN).map((each) => each.name) : runs === "none" ? [] : runs.split(",").map(unescaped);
    return names.filter((name) => this.content.runs.some((each) => each.name === name));
  }

  choose(name, isChosen) {
    const names = isChosen ? [...this.chosen(), name] : this.chosen().filter((each) => each !== name);
    change({ runs: names.length ? names.map(escaped).join(",") : "none" }, { replace: true });
  }

  metrics() {
    const chosen = this.chosen();
    const known = new Set(this.content.runs.filter((each) => chosen.includes(each.name)).flatMap((each) => each.metrics));
    return known.size ? [...known] : ["episode"];
  }

  shownMetric() {
    const metrics = this.metrics(), { metric } = view();
    return metrics.includes(metric) ? metric : metrics.includes("evaluation:reward") ? "evaluation:reward" : metrics[0];
  }

  show() {
    const { runs, recordings } = this.content;
    this.empty.hidden = runs.length + recordings.length > 0;
    if (!runs.length) setText(this.empty, "There is no training in the folder yet: zenostat train FILE.yaml --output FOLDER/NAME");
    this.body.hidden = !runs.length;
    this.recordingsPanel.hidden = !recordings.length;
    const metrics = this.metrics();
    if (this.metric.dataset.metrics !== metrics.join()) {
      this.metric.dataset.metrics = metrics.join();
      fill(this.metric, metrics.map((each) => h("option", { value: each }, metricText(each))));
    }
    this.metric.value = this.shownMetric();
    const text = JSON.stringify([this.content, this.chosen()]);
    if (text === this.text) return;
    this.text = text;
    const focused = document.activeElement?.closest?.("[data-key]")?.dataset.key;
    fill(this.rows, runs.map((each) => this.row(each)));
    fill(this.studies, this.content.studies.map((study) => this.study(study)));
    fill(this.recordings, recordings.map((each) => this.recording(each)));
    this.showWatched();
    if (focused) document.querySelector(`[data-key="${CSS.escape(focused)}"]`)?.focus();
  }

  color(name) { return COLORS[this.content.runs.findIndex((each) => each.name === name) % COLORS.length]; }

  row(run) {
    const kind = { training: "good", stopped: "warning" }[run.state] ?? "muted";
    const report = this.content.reports[run.name];
    const references = Object.entries(run.references).map(([name, value]) => `${name} ${num(value)}`).join(", ");
    const box = h("input", { type: "checkbox", "data-key": `curve ${run.name}`, "aria-label": `Draw ${run.name}`, checked: this.chosen().includes(run.name), onchange: (event) => this.choose(run.name, event.target.checked) });
    const best = Object.values(run.references).length && run.best !== null ? (run.best > Math.max(...Object.values(run.references)) ? "better" : "worse") : null;
    return h("tr", {},
      h("td", {}, box), h("th", { scope: "row" }, run.name, run.problem && h("p", { class: "problem" }, run.problem)),
      h("td", {}, h("span", { class: `chip ${kind}` }, run.state)), h("td", {}, `${run.algorithm}${run.seed === null ? "" : `, seed ${run.seed}`}`),
      h("td", { class: "number" }, run.steps ? `${count(run.step)} of ${count(run.steps)}` : count(run.step)), h("td", { class: "number" }, num(run.reward)),
      h("td", { class: `number ${best ?? ""}` }, num(run.best)), h("td", { class: "number" }, references || "–"),
      h("td", {}, h("div", { class: "row" },
        run.has_report && h("a", { href: `/api/trainings/report?${new URLSearchParams({ name: run.name })}`, target: "_blank", rel: "noopener", "aria-label": `Report of ${run.name}` }, "Report"),
        h("button", forOperators({ class: "small", "data-key": `report ${run.name}`, disabled: report?.state === "making", "aria-label": `Make a report of ${run.name}`, onclick: () => this.send("report", { name: run.name }) }), report?.state === "making" ? "Making …" : run.has_report ? "Make again" : "Make report"),
        run.has_scenario && h("button", forOperators({ class: "small", "data-key": `watch ${run.name}`, "aria-label": `Watch ${run.name} on a node`, onclick: () => this.watch(run) }), "Watch")),
      report?.state === "failed" && h("p", { class: "problem" }, report.text)));
  }

  recording({ name, run, bytes: size }) {
    return h("tr", {}, h("th", { scope: "row" }, name), h("td", {}, run ?? "–"), h("td", { class: "number" }, bytes(size)),
      h("td", {}, h("button", forOperators({ class: "small", "data-key": `replay ${name}`, "aria-label": `Replay ${name}`, onclick: () => this.replay(name) }), "Replay")));
  }

  async send(operation, content) {
    try {
      toast((await post(`/api/trainings/${operation}`, content)).text);
      this.poll();
    } catch (error) { toast(error.message, true); }
  }

  watch({ name }) {
    this.start("watch", name, "Watch a training", "Starts a node from the scenario of the training, controlled by its best model so far. It ends with the control room.");
  }

  replay(name) {
    this.start("replay", name, "Replay a recording", "Starts a node that publishes the recording again, from its begin to its end. It ends with the control room, too.");
  }

  /** Ask for a node's name and speed, and start it. */
  start(operation, name, title, text) {
    const proposed = name.split("/").at(-1).replace(/\.mcap$/, "").replace(/[^A-Za-z0-9_.-]/g, "_").replace(/^[.-]+/, "").slice(0, 128);
    const node = h("input", { id: "start-node", required: true, maxlength: 128, value: proposed || "node", spellcheck: "false" });
    const speed = h("input", { id: "start-speed", type: "number", min: 0, step: "any", required: true, value: 3600 });
    const submit = () => this.send(operation, { name, node: node.value, speed: Number(speed.value) });
    openDialog({ title, action: "Start", label: `${title}: ${name}`, submit }, h("p", { class: "code" }, name), h("p", {}, text),
      h("label", { for: "start-node" }, "Name of the node"), node, h("label", { for: "start-speed" }, "Times the wall clock"), speed);
  }

  /** Nodes that were started from this page. */
  showWatched() {
    const { runs, recordings } = this.content;
    this.showStarted(this.watched, runs, "controlled by");
    this.showStarted(this.replayed, recordings, "replays");
  }

  showStarted(list, sources, text) {
    const names = new Set(sources.map((each) => each.name));
    const focused = list.contains(document.activeElement) ? document.activeElement.dataset.key : null;
    fill(list, this.started.filter((each) => names.has(each.scenario) && each.state !== "ended").map((each) => h("li", { class: "row wrap" },
      this.online.has(each.name) ? h("a", { "data-key": `open ${each.name}`, href: address({ node: each.name }, false), onclick: (event) => link(event, { node: each.name }) }, `Open ${each.name}`) : h("span", {}, each.name),
      h("span", { class: `chip ${each.state === "failed" ? "alarm" : "good"}` }, each.state), h("span", { class: each.text ? "problem" : "muted" }, each.text || `${text} ${each.scenario}`),
      each.state !== "failed" && h("button", forOperators({ class: "small", "data-key": `end ${each.name}`, "aria-label": `End ${each.name}`, onclick: () => this.end(each.name) }), "End"))));
    if (focused) list.querySelector(`[data-key="${CSS.escape(focused)}"]`)?.focus();
  }

  async end(node) {
    try { toast((await post("/api/builder/stop", { node })).text); } catch (error) { toast(error.message, true); }
  }

  // Curves

  async load() {
    const metric = this.shownMetric();
    const wanted = this.chosen().map((name) => this.content.runs.find((each) => each.name === name)).filter((each) => each.metrics.includes(metric));
    await Promise.all(wanted.map(async (run) => {
      const version = JSON.stringify([metric, run.step, run.episodes, run.evaluation, run.metrics.length]);
      if (this.curves.get(run.name)?.version === version) return;
      try { this.curves.set(run.name, { version, ...(await get(`/api/trainings/curve?${new URLSearchParams({ name: run.name, metric })}`)) }); } catch (error) { toast(error.message, true); }
    }));
    if (this.isClosed) return;
    this.lines = wanted.map((run) => this.curves.get(run.name)).filter((each) => each?.metric === metric && each.step.length);
    this.draw();
  }

  series() {
    const steps = [...new Set(this.lines.flatMap((each) => each.step))].sort((a, b) => a - b);
    const place = new Map(steps.map((step, index) => [step, index]));
    const spread = (line, values) => { const all = new Array(steps.length).fill(null); values && line.step.forEach((step, index) => { all[place.get(step)] = values[index]; }); return values && all; };
    const series = this.lines.map((line) => ({ label: line.name, unit: "", color: this.color(line.name), values: spread(line, line.mean), lows: spread(line, line.low), highs: spread(line, line.high), gaps: true, dots: line.step.length < 3 }));
    const references = new Map(this.lines.flatMap((line) => Object.entries(line.references).map(([name, value]) => [`${name} ${value}`, [name, value]])));
    for (const [label, value] of references.values()) series.push({ label, unit: "", color: getComputedStyle(document.documentElement).getPropertyValue("--muted").trim(), dash: [6, 4], values: steps.map(() => value) });
    return [steps, series];
  }

  draw() {
    const text = JSON.stringify([this.lines?.map((each) => [each.name, each.version]), this.canvas.clientWidth, document.documentElement.dataset.theme]);
    if (text === this.shape) return;
    this.shape = text;
    this.plot?.destroy();
    this.plot = null;
    if (!this.lines?.length || !this.canvas.clientWidth) {
      fill(this.canvas, h("p", { class: "empty" }, "Choose trainings in the list whose curves are drawn; one that has just begun has none yet."));
      fill(this.legend);
      return;
    }
    const [steps, series] = this.series();
    fill(this.canvas);
    this.drawn = series;
    this.plot = chart(this.canvas, { time: steps, series, height: this.canvas.clientWidth < 500 ? 230 : 320, isTime: false });
    fill(this.legend, series.map((each, column) => h("li", {}, swatch(each), h("span", {}, each.label), h("span", { class: "number legend-value", "data-column": column }, num(latest(each.values))))));
    setAttribute(this.canvas, "role", "img");
    setAttribute(this.canvas, "aria-label", `${metricText(this.shownMetric())} over training steps: ${series.map((each) => `${each.label}, now ${num(latest(each.values))}`).join("; ")}`);
  }

  tip(plot) {
    const { idx } = plot.cursor;
    for (const cell of this.legend.querySelectorAll(".legend-value")) {
      const { values } = this.drawn[cell.dataset.column];
      setText(cell, num(idx === null || idx === undefined ? latest(values) : values[idx]));
    }
    setText(this.when, idx === null || idx === undefined ? "" : `step ${count(plot.data[0][idx])}`);
  }

  // Studies

  study(study) {
    const complete = study.trials.filter((each) => each.state === "complete" && each.value !== null);
    const best = complete.reduce((first, each) => (first === null || each.value > first.value ? each : first), null);
    const heads = [["Trial"], ["State"], [words(study.metric), "number"], ...study.varied.map((name) => [name.replace(/^parameters\./, "")])];
    const known = new Set(this.content.runs.map((each) => each.name));
    return h("section", { class: "panel", "aria-labelledby": `study-${study.name}` },
      h("h2", { id: `study-${study.name}` }, `Study ${study.name || "of this folder"}`),
      h("p", { class: "muted" }, `${complete.length} of ${counted(study.trials.length, "trial")} ${[complete.length, study.trials.length].includes(1) ? "is" : "are"} complete${best ? `; the highest ${study.metric} is ${num(best.value)}, of trial ${best.number}` : ""}.`),
      h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": `Trials of ${study.name}` }, h("table", {},
        h("thead", {}, h("tr", {}, heads.map(([head, kind]) => h("th", { scope: "col", class: kind ?? null }, head)))),
        h("tbody", {}, study.trials.map((trial) => h("tr", { class: trial === best ? "effective" : null },
          h("th", { scope: "row" }, known.has(trial.run) ? h("button", { class: "plain", "data-key": `trial ${trial.run}`, "aria-label": `Draw trial ${trial.number} of ${study.name}`, onclick: () => this.choose(trial.run, !this.chosen().includes(trial.run)) }, String(trial.number)) : trial.number),
          h("td", { title: trial.reason || null }, words(trial.state)), h("td", { class: "number" }, num(trial.value)),
          study.varied.map((name) => h("td", {}, parameterText(trial.parameters[name])))))))));
  }
}

/** A name as part of a list that is separated by commas. */
const escaped = (name) => name.replaceAll("%", "%25").replaceAll(",", "%2C");
const unescaped = (text) => text.replaceAll("%2C", ",").replaceAll("%25", "%");

/** The head of a column; one without a text has a name for readers of the screen. */
const heading = ([text, hidden, kind]) => h("th", { scope: "col", class: kind || null }, text || h("span", { class: "visually-hidden" }, hidden));

/** `evaluation:reward` as `evaluation: reward`. */
function metricText(metric) {
  if (metric === "episode") return "reward, mean of 100 training episodes";
  const [kind, ...name] = metric.split(":");
  return `${kind}: ${words(name.join(":"))}`;
}

function parameterText(value) {
  if (value === undefined) return "";
  if (typeof value === "number") return String(Number(value.toPrecision(4)));
  return typeof value === "object" ? JSON.stringify(value) : String(value);
}

function latest(values) {
  for (let place = values.length - 1; place >= 0; place -= 1) if (values[place] !== null) return values[place];
  return null;
}
