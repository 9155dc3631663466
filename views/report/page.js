'use strict';
(() => {
const CODE = 'ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/';
const DAY_MS = 864e5;
const LEAST_DRAG = 4;
const EDGE = 2;
const NEAR = 12;
const STEPS = [1 / 96, 1 / 48, 1 / 24, 1 / 12, 1 / 8, 1 / 4, 1 / 2, 1, 2, 7, 14, 30];
const PERCENTS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 25];
const charts = [];

// Values that `readings.py` packed: the lowest, the highest, and letters for each value between them.
function unpack([low, high, packed], letters) {
  const text = packed.replace(new RegExp(`([^*]{${letters}})\\*(\\d+)\\*`, 'g'), (_, code, count) => code.repeat(count));
  const top = 64 ** letters - 2, values = [];
  for (let at = 0; at < text.length; at += letters) {
    let level = 0;
    for (let k = 0; k < letters; k++) level = level * 64 + CODE.indexOf(text[at + k]);
    values.push(level > top ? NaN : low + (high - low) * level / top);
  }
  return values;
}

function series(entry) {
  const [low, high] = entry.y, y = unpack(entry.y, 2), places = entry.x || [0, 1];
  const x = places.length === 2 ? y.map((_, k) => places[0] + k * places[1]) : unpack(places, 4);
  const size = Math.floor(Math.log10(Math.max(Math.abs(low), Math.abs(high)) || 1));
  const most = Math.min(Math.max(2, 2 - size), 20);  // three significant ones of the largest value
  const digits = high > low ? Math.max(Math.min(Math.floor(-Math.log10((high - low) / 4094)), most), 0) : most;
  return {...entry, x, y, digits, isCells: !entry.x};
}

function text(line, value, unit) {
  if (Number.isNaN(value) || value === undefined) return '\u2013';
  if (line.texts) return line.texts[Math.round(value)];
  const digits = {minimumFractionDigits: line.digits, maximumFractionDigits: line.digits};
  const rounded = Number(value.toFixed(line.digits)) + 0;
  return `${rounded.toLocaleString('en-US', digits).replace('-', '\u2212')}${unit && '\u00a0'}${unit}`;
}

function when(axis, x, form) {
  if (!axis.begin) return `${Number(x.toFixed(form === 'tick' ? 1 : 2))} %${form === 'tick' ? '' : ' of the time'}`;
  const date = new Date(Math.round((Date.parse(`${axis.begin}T00:00Z`) + x * DAY_MS) / 6e4) * 6e4);
  const part = options => date.toLocaleString('en-GB', {timeZone: 'UTC', ...options}).replace(',', '');
  const day = () => part({weekday: 'short', day: 'numeric', month: 'short'}).replace('Sept', 'Sep');
  const clock = () => part({hour: '2-digit', minute: '2-digit'});
  if (form === 'tick') return date.getUTCHours() + date.getUTCMinutes() ? clock() : day();
  return form === 'day' ? day() : `${day()} ${clock()}`;
}

function element(name, attributes, parent) {
  const made = document.createElementNS('http://www.w3.org/2000/svg', name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return parent.appendChild(made);
}

class Chart {
  constructor(block) {
    this.figure = block.parentElement;
    this.scroll = this.figure.querySelector('.scroll');
    this.svg = this.figure.querySelector('svg');
    this.block = block;
    this.view = [0, 1];
    this.svg.classList.add('live');
    this.marks = element('g', {class: 'marks'}, this.svg);
    this.tip = document.createElement('div');
    this.tip.className = 'tip';
    this.tip.hidden = true;
    this.figure.append(this.tip);
    this.svg.addEventListener('pointermove', event => this.move(event));
    this.svg.addEventListener('pointerdown', event => this.press(event));
    this.svg.addEventListener('pointerup', event => this.release(event));
    this.svg.addEventListener('pointercancel', () => { this.from = undefined; });
    this.svg.addEventListener('pointerleave', event => event.pointerType === 'touch' || this.hide());
    this.svg.addEventListener('dblclick', () => this.zoom(0, 1));
    this.scroll.addEventListener('keydown', event => this.key(event));
    this.scroll.addEventListener('blur', () => this.hide());
  }

  get axes() {
    if (this.known) return this.known;
    const name = this.svg.getAttribute('aria-labelledby').split('-title ')[0];
    this.known = JSON.parse(this.block.textContent).map((axis, place) => {
      const group = document.getElementById(`${name}-reading-${place}`);
      const uses = [...group.querySelectorAll('g[clip-path] use')];
      const filled = uses.map(use => document.getElementById(use.getAttribute('href').slice(1)));
      const parts = [...group.querySelectorAll('path[clip-path]'), ...filled].map(path => [path, path.getAttribute('d')]);
      const images = [...group.querySelectorAll('g[clip-path] image')].map(part => [part, part.getAttribute('transform')]);
      return {...axis, series: axis.series.map(series), group, parts, images};
    });
    return this.known;
  }

  get isCells() { return this.axes[0].series[0].isCells; }

  toPixel({box, span}, x) {
    return box[0] + ((x - span[0]) / (span[1] - span[0]) - this.view[0]) / (this.view[1] - this.view[0]) * (box[2] - box[0]);
  }

  share({box}, pixel) {
    const [from, to] = this.view, inside = (pixel - box[0]) / (box[2] - box[0]);
    return from + Math.min(Math.max(inside, 0), 1) * (to - from);
  }

  at(event) {
    const box = this.svg.getBoundingClientRect(), scale = this.svg.viewBox.baseVal.width / box.width;
    return [(event.clientX - box.left) * scale, (event.clientY - box.top) * scale];
  }

  move(event) {
    const [x, y] = this.at(event), {axes} = this;
    if (this.from) return this.drag(x);
    const beside = axes.filter(({box}) => x >= box[0] - EDGE && x <= box[2] + EDGE);
    const far = ({box}) => Math.max(box[1] - y, y - box[3], 0), [axis] = beside.sort((a, b) => far(a) - far(b));
    if (!axis || far(axis) > NEAR) return this.hide();
    const {box, span} = axis;
    this.show(axis, span[0] + this.share(axis, x) * (span[1] - span[0]), Math.floor((box[3] - y) / (box[3] - box[1]) * 24));
  }

  press(event) {
    this.move(event);
    if (event.button || event.pointerType === 'touch' || !this.axis) return;
    event.preventDefault();
    this.svg.setPointerCapture(event.pointerId);
    this.from = {axis: this.axis, x: this.at(event)[0]};
  }

  drag(x) {
    const {box} = this.from.axis, ends = [this.from.x, Math.min(Math.max(x, box[0]), box[2])].sort((a, b) => a - b);
    this.hide();
    element('rect', {class: 'range', x: ends[0], y: box[1], width: ends[1] - ends[0], height: box[3] - box[1]}, this.marks);
  }

  release(event) {
    if (!this.from) return;
    const {axis, x} = this.from, to = this.at(event)[0];
    this.from = undefined;
    this.hide();
    if (Math.abs(to - x) > LEAST_DRAG) this.zoom(...[x, to].map(pixel => this.share(axis, pixel)).sort((a, b) => a - b));
  }

  // Show the values at a place of an axis: of all carpets in this hour, or of all lines of the axis.
  show(axis, x, hour) {
    for (const other of charts) if (other !== this) other.hide();
    const main = axis.series.find(line => !line.step) || axis.series[0];
    if (this.isCells) x = Math.min(Math.floor(x), axis.span[1] - 1);
    else if (!main.step) x = main.x[this.nearest(main, x)];
    hour = Math.min(Math.max(hour, 0), 23);
    Object.assign(this, {axis, x, hour});
    this.marks.replaceChildren();
    const rows = [];
    for (const each of this.axes) {
      const {box} = each, left = this.toPixel(each, x);
      if (this.isCells) {
        const height = (box[3] - box[1]) / 24, width = this.toPixel(each, x + 1) - left;
        element('rect', {class: 'cell', x: left, y: box[3] - (hour + 1) * height, width, height}, this.marks);
      } else {
        element('line', {x1: left, x2: left, y1: box[1], y2: box[3]}, this.marks);
      }
      for (const line of this.isCells || each === axis ? each.series : []) {
        const value = line.y[this.isCells ? x * 24 + hour : this.nearest(line, x)];
        rows.push([line.color, line.label || each.title, text(line, value, each.unit)]);
      }
    }
    const isDaily = this.isCells || (main.x.length > 2 && main.x[1] - main.x[0] === 1);
    const hours = this.isCells ? `, ${hour}\u2013${hour + 1} h` : '';
    this.write(`${when(axis, x, isDaily ? 'day' : 'time')}${hours}`, rows);
  }

  // The place of the nearest value, or of the one that holds.
  nearest({x: places, step}, x) {
    let low = 0, high = places.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (places[middle] <= x + 1e-6) low = middle + 1; else high = middle;
    }
    if (step) return Math.max(low - 1, 0);
    return low && (low === places.length || x - places[low - 1] <= places[low] - x) ? low - 1 : low;
  }

  write(heading, rows) {
    const head = document.createElement('b');
    head.textContent = heading;
    this.tip.replaceChildren(head, ...rows.map(([color, label, value]) => {
      const row = document.createElement('div'), mark = document.createElement('i'), amount = document.createElement('span');
      mark.style.background = color;
      amount.textContent = value;
      row.append(...(color ? [mark] : []), `${label} `, amount);
      return row;
    }));
    this.tip.hidden = false;
    const scale = this.svg.getBoundingClientRect().width / this.svg.viewBox.baseVal.width, {box} = this.axis;
    const place = this.toPixel(this.axis, this.x) * scale - this.scroll.scrollLeft, wide = this.figure.clientWidth;
    const end = this.isCells ? this.toPixel(this.axis, this.x + 1) * scale - this.scroll.scrollLeft : place;
    const left = end + 14 + this.tip.offsetWidth > wide ? place - 14 - this.tip.offsetWidth : end + 14;
    this.tip.style.left = `${Math.max(Math.min(left, wide - this.tip.offsetWidth), 0)}px`;
    this.tip.style.top = `${this.scroll.offsetTop + box[1] * scale}px`;
  }

  hide() {
    this.marks.replaceChildren();
    this.tip.hidden = true;
    this.axis = undefined;
  }

  zoom(from, to) {
    const days = this.axes[0].span[1], least = this.isCells ? Math.min(2 / days, 1) : 1 / 200;
    if (this.isCells) [from, to] = [Math.floor(from * days + 1e-6) / days, Math.ceil(to * days - 1e-6) / days];
    const size = Math.min(Math.max(to - from, least), 1), middle = this.isCells ? from + size / 2 : (from + to) / 2;
    const start = Math.min(Math.max(middle - size / 2, 0), 1 - size);
    this.view = [start, start + size];
    for (const axis of this.axes) this.apply(axis);
  }

  apply(axis) {
    const {box, span, group, parts, images} = axis, isWhole = this.view[1] - this.view[0] === 1;
    const scale = 1 / (this.view[1] - this.view[0]), shift = box[0] - scale * (box[0] + this.view[0] * (box[2] - box[0]));
    const moved = (_, letter, x) => `${letter} ${(x * scale + shift).toFixed(2)}`;
    for (const [part, path] of parts) part.setAttribute('d', isWhole ? path : path.replace(/([ML]) (-?[\d.]+)/g, moved));
    for (const [part, own] of images) part.setAttribute('transform', isWhole ? own : `matrix(${scale} 0 0 1 ${shift} 0) ${own}`);
    group.querySelectorAll('.zoomed').forEach(tick => tick.remove());
    const own = [...group.querySelectorAll('.tick')], model = own.find(tick => tick.querySelector('text')) || own[0];
    own.forEach(tick => { isWhole ? tick.removeAttribute('style') : tick.style.display = 'none'; });
    if (isWhole || !model) return;
    const size = span[1] - span[0], shown = (this.view[1] - this.view[0]) * size, first = span[0] + this.view[0] * size;
    const fitting = Math.max((box[2] - box[0]) / 60, 1), steps = axis.begin ? STEPS.slice(this.isCells ? 7 : 0) : PERCENTS;
    const step = steps.find(each => shown / each <= fitting) || steps[steps.length - 1];
    const unit = Math.min(step, 1), isMonth = place => new Date(Date.parse(axis.begin) + place * DAY_MS).getUTCDate() === 1;
    for (let count = Math.ceil(first / unit - 1e-6); count * unit <= first + shown + 1e-6; count++) {
      const place = count * unit;
      if (axis.begin && step >= 30 ? !isMonth(place) : Math.abs(Math.round(place / step) * step - place) > 1e-6) continue;
      const tick = model.cloneNode(true), x = this.toPixel(axis, place), label = tick.querySelector('text');
      tick.setAttribute('class', 'zoomed');
      tick.style.display = '';
      tick.querySelectorAll('use, text').forEach(part => part.setAttribute('x', x));
      if (label) label.textContent = axis.begin && x > box[2] - 40 ? '' : when(axis, place, 'tick');
      model.parentElement.append(tick);
    }
  }

  key(event) {
    const {axes} = this, place = Math.max(axes.indexOf(this.axis), 0), axis = axes[place];
    const size = axis.span[1] - axis.span[0], [from, to] = this.view;
    const x = this.axis ? this.x : axis.span[0] + (from + to) / 2 * size, hour = this.axis ? this.hour : 12;
    const line = axis.series.find(each => !each.step), share = (x - axis.span[0]) / size;
    const sideways = {ArrowLeft: -1, ArrowRight: 1}[event.key], upward = {ArrowUp: 1, ArrowDown: -1}[event.key];
    const factor = {'+': 0.5, '=': 0.5, '-': 2}[event.key];
    if (event.ctrlKey || event.metaKey || event.altKey || !(sideways || upward || factor)) return;
    event.preventDefault();
    let next = x, other = axis;
    if (sideways && this.isCells) next = x + sideways;
    else if (sideways && line) {
      const leap = Math.max(Math.round((to - from) * line.x.length / 100), 1);
      next = line.x[Math.min(Math.max(this.nearest(line, x) + (this.axis ? sideways * leap : 0), 0), line.x.length - 1)];
    } else if (sideways) next = x + sideways * (to - from) * size / 100;
    if (upward && !this.isCells) other = axes[(place - upward + axes.length) % axes.length];
    if (factor) this.zoom(share - (to - from) * factor / 2, share + (to - from) * factor / 2);
    const [low, high] = this.view.map(edge => axis.span[0] + edge * size);
    this.tip.setAttribute('aria-live', 'polite');
    this.show(other, Math.min(Math.max(next, low), this.isCells ? high - 1 : high), hour + (upward && this.isCells ? upward : 0));
    const pixel = this.toPixel(other, this.x) / this.svg.viewBox.baseVal.width * this.svg.getBoundingClientRect().width;
    this.scroll.scrollLeft = pixel - this.scroll.clientWidth / 2;
    this.tip.hidden || this.show(other, this.x, this.hour);
  }
}

for (const [event, isOpen] of [['beforeprint', true], ['afterprint', false]]) {
  addEventListener(event, () => document.querySelectorAll('details.print').forEach(part => { part.open = isOpen; }));
}
document.querySelectorAll('figure > script').forEach(block => charts.push(new Chart(block)));
document.getElementById('hint').hidden = !charts.length;
addEventListener('keydown', event => {
  if (event.key === 'Escape') for (const chart of charts) { chart.from = undefined; chart.hide(); chart.zoom(0, 1); }
});
})();
