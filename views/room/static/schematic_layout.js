// Where the boxes and pipes of a loop are: pure geometry, in pixels, of boxes whose sizes are given.

const GAP = 24, ROW = 16, RAIL = 22, PORT = 20, TAP = 12;

const shift = (block, dx, dy) => ({
  ...block,
  boxes: block.boxes.map((box) => ({ ...box, x: box.x + dx, y: box.y + dy })),
  pipes: block.pipes.map((pipe) => pipe.map(([x, y]) => [x + dx, y + dy])),
  entry: [block.entry[0] + dx, block.entry[1] + dy],
  exit: [block.exit[0] + dx, block.exit[1] + dy],
});

const mirror = (block, width) => ({
  ...block,
  boxes: block.boxes.map((box) => ({ ...box, x: width - box.x - box.w })),
  pipes: block.pipes.map((pipe) => pipe.map(([x, y]) => [width - x, y])),
  entry: [width - block.entry[0], block.entry[1]],
  exit: [width - block.exit[0], block.exit[1]],
});

/** Components one behind another, in rows as wide as there is room. */
function series(boxes, width) {
  const placed = [], pipes = [];
  let x = 0, y = 0, height = 0, last = null, right = 0;
  for (const box of boxes) {
    if (x > 0 && x + box.w > width) {
      const turn = y + height + ROW / 2;
      pipes.push([[last, y + PORT], [last + GAP / 2, y + PORT], [last + GAP / 2, turn], [-GAP / 2, turn], [-GAP / 2, turn + ROW / 2 + PORT], [0, turn + ROW / 2 + PORT]]);
      y += height + ROW;
      x = height = 0;
    } else if (last !== null) pipes.push([[last, y + PORT], [x, y + PORT]]);
    placed.push({ ...box, x, y });
    last = x + box.w;
    right = Math.max(right, last);
    x = last + GAP;
    height = Math.max(height, box.h);
  }
  return { w: right, h: y + height, boxes: placed, pipes, entry: [0, PORT], exit: [last ?? 0, y + PORT] };
}

/** One or two parallel branches, and bypasses, above each other, between two headers. */
function stack(branches, width) {
  const rows = branches.map((branch) => series(branch, width - 2 * RAIL));
  const inner = Math.max(60, ...rows.map((row) => row.w));
  const block = { w: inner + 2 * RAIL, h: 0, boxes: [], pipes: [], entry: [0, PORT], exit: [inner + 2 * RAIL, PORT] };
  const ports = [];
  let y = 0;
  for (const row of rows) {
    const placed = shift(row, RAIL, y);
    const isBypass = !row.boxes.length;
    block.boxes.push(...placed.boxes);
    block.pipes.push(...placed.pipes);
    if (isBypass) block.pipes.push([[0, y + PORT], [block.w, y + PORT]]);
    else block.pipes.push([[0, placed.entry[1]], placed.entry], [placed.exit, [block.w, placed.exit[1]]]);
    ports.push([placed.entry[1], placed.exit[1]]);
    y += (isBypass ? PORT + 8 : row.h) + ROW;
  }
  block.h = y - ROW;
  block.pipes.push([[0, ports[0][0]], [0, ports.at(-1)[0]]], [[block.w, ports[0][1]], [block.w, ports.at(-1)[1]]]);
  return block;
}

/** Many parallel branches side by side, each from top to bottom, between a header above and a collector below. */
function grid(branches, width, isPiped) {
  const cell = Math.max(...branches.flat().map((box) => box.w), 60);
  const columns = Math.max(1, Math.floor((width - RAIL + GAP) / (cell + GAP)));
  const block = { w: width, h: 0, boxes: [], pipes: [], entry: [0, 0], exit: [width, 0] };
  const headers = [], collectors = [];
  let y = 0;
  for (let first = 0; first < branches.length; first += columns) {
    const row = branches.slice(first, first + columns);
    const heights = row.map((branch) => branch.reduce((sum, box) => sum + box.h + TAP, -TAP));
    const height = Math.max(...heights, 20);
    const bottom = y + TAP + height + TAP;
    row.forEach((branch, place) => {
      const x = RAIL / 2 + place * (cell + GAP), middle = x + cell / 2;
      let top = y + TAP;
      let from = y;
      for (const box of branch) {
        block.boxes.push({ ...box, w: cell, x, y: top });
        if (isPiped || from > y) block.pipes.push([[middle, from], [middle, top]]);
        from = top + box.h;
        top = from + TAP;
      }
      if (isPiped) block.pipes.push([[middle, from], [middle, bottom]]);
    });
    if (isPiped) {
      const middles = row.map((_, place) => RAIL / 2 + place * (cell + GAP) + cell / 2);
      block.pipes.push([[0, y], [middles.at(-1), y]], [[middles[0], bottom], [width, bottom]]);
    }
    headers.push(y);
    collectors.push(bottom);
    y = bottom + ROW;
  }
  block.h = collectors.at(-1);
  block.entry = [0, headers[0]];
  block.exit = [width, collectors.at(-1)];
  if (isPiped) block.pipes.push([[0, headers[0]], [0, headers.at(-1)]], [[width, collectors[0]], [width, collectors.at(-1)]]);
  return block;
}

const gridWidth = (branches) => branches.length * (Math.max(...branches.flat().map((box) => box.w), 60) + GAP) - GAP + RAIL;

function stage(branches, width) {
  if (branches.length === 1) return series(branches[0], width);
  const widest = Math.max(...branches.map((branch) => branch.reduce((sum, box) => sum + box.w + GAP, -GAP)));
  return branches.filter((branch) => branch.length).length <= 2 && widest + 2 * RAIL <= width ? stack(branches, width) : grid(branches, width, true);
}

/** The stages of a side, beside each other if there is room, or else below each other. */
function side(stages, width) {
  let blocks = stages.map((branches) => stage(branches, width));
  const needed = stages.map((branches, place) => (blocks[place].entry[1] === PORT ? blocks[place].w : gridWidth(branches)));
  const isWide = needed.reduce((sum, each) => sum + each + GAP, -GAP) <= width;
  if (isWide && blocks.length > 1) blocks = stages.map((branches, place) => stage(branches, needed[place]));
  const result = { w: width, h: 0, boxes: [], pipes: [], entry: null, exit: null };
  let x = 0, y = 0;
  for (const block of blocks) {
    const placed = shift(block, x, isWide && block.entry[1] === 0 && blocks.length > 1 ? y + PORT : y);
    result.boxes.push(...placed.boxes);
    result.pipes.push(...placed.pipes);
    if (result.exit && isWide) result.pipes.push([result.exit, [result.exit[0] + GAP / 2, result.exit[1]], [result.exit[0] + GAP / 2, placed.entry[1]], placed.entry]);
    else if (result.exit) {
      const turn = y - ROW / 2;
      result.pipes.push([result.exit, [width + RAIL / 4, result.exit[1]], [width + RAIL / 4, turn], [-RAIL / 4, turn], [-RAIL / 4, placed.entry[1]], placed.entry]);
    }
    result.entry ??= placed.entry;
    result.exit = placed.exit;
    result.h = Math.max(result.h, y + block.h + (block.entry[1] ? 0 : PORT));
    if (isWide) x += block.w + GAP; else y += block.h + ROW;
  }
  return result;
}

/** Boxes and pipes of a loop: the supply from left to right, and below it the demand on the way back.
 *
 * `supply` and `demand` are stages of parallel branches of boxes `{w, h, …}`; `caption` is the height of a caption.
 */
export function layout(supply, demand, width, caption) {
  const inner = width - 2 * RAIL - 2;
  const blocks = [], captions = [];
  let y = 0;
  const add = (stages, isDemand) => {
    captions.push(y);
    y += caption;
    const block = shift(isDemand ? mirror(side(stages, inner), inner) : side(stages, inner), RAIL + 1, y);
    y += block.h + ROW;
    blocks.push(block);
  };
  if (supply.length) add(supply, false);
  if (demand.length) add(demand, true);
  const flow = [], back = [];
  if (blocks.length === 2) {
    const [first, second] = blocks, left = 2, right = width - 2;
    flow.push([first.exit, [right, first.exit[1]], [right, second.entry[1]], second.entry]);
    back.push([second.exit, [left, second.exit[1]], [left, first.entry[1]], first.entry]);
  }
  return {
    boxes: blocks.flatMap((block) => block.boxes), height: y, captions, flow,
    pipes: [...blocks.flatMap((block) => block.pipes), ...back], ends: flow.concat(back).map((pipe) => pipe.slice(-2)),
  };
}

/** Boxes of zones with equipment of their own, which no loop connects. */
export function cells(branches, width) {
  const block = shift(grid(branches, width - 2, false), 0, 0);
  return { boxes: block.boxes, height: block.h, captions: [], pipes: block.pipes, flow: [], ends: [] };
}
