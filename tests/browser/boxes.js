() => {
  const found = [];
  const wide = window.innerWidth, high = window.innerHeight;
  const name = (one) => one.dataset?.act || one.dataset?.go || one.dataset?.map || one.dataset?.steer
    || (/^c\d+$/.test(one.id) ? "" : one.id) || one.getAttribute?.("aria-label") || one.className || one.tagName;
  const isSeen = (one) => one.checkVisibility({visibilityProperty: true});
  const at = (x, y) => document.elementFromPoint(x, y);
  const hits = (one, x, y) => { const hit = at(x, y); return hit && (one.contains(hit) || hit.contains(one)); };

  // STOP: all of it, at every moment.
  const stop = document.querySelector("[data-act=stop]");
  if (!stop) return ["there is no STOP"];
  const box = stop.getBoundingClientRect();
  if (box.left < 0 || box.top < 0 || box.right > wide || box.bottom > high) found.push("STOP leaves the page");
  for (const [x, y] of [[.5, .5], [.06, .1], [.94, .1], [.06, .9], [.94, .9]]) {
    const hit = at(box.left + x * box.width, box.top + y * box.height);
    if (!hit || !stop.contains(hit)) found.push(`STOP is covered by ${hit && name(hit)}`);
  }
  if (box.width < 88 || box.height < 44) found.push(`STOP is ${box.width} x ${box.height}`);

  // No sideways scroll, neither of the page nor of a view.
  for (const one of [document.scrollingElement, ...document.querySelectorAll("#stage, #header, section[data-view], .place")])
    if (isSeen(one) && one.scrollWidth > one.clientWidth + 1 && one.clientWidth)
      found.push(`${name(one)} is ${one.scrollWidth - one.clientWidth} px too wide`);

  // What can be pressed is large enough, on the page, and hit where it is seen.
  const isModal = document.querySelector(".q-dialog__backdrop");
  const pressed = "button, .stick, [role=button], [role=tab], [role=switch], input:not([type=file]), select";
  for (const one of document.querySelectorAll(pressed)) {
    if (!isSeen(one) || one.closest("[aria-hidden=true], .q-uploader")) continue;
    const b = one.getBoundingClientRect();
    if (!b.width) continue;
    const own = one.matches("button, .stick");
    if (own && !one.closest(".q-btn-group, .q-field") && (b.width < 43.5 || b.height < 43.5))
      found.push(`${name(one)} is ${b.width.toFixed(0)} x ${b.height.toFixed(0)}`);
    if (b.left < -1 || b.right > wide + 1) found.push(`${name(one)} leaves the page sideways`);
    let scrolled = false;
    for (let up = one.parentElement; up; up = up.parentElement) {
      const frame = up.getBoundingClientRect(), style = getComputedStyle(up);
      if (/auto|scroll/.test(style.overflowY) && (b.bottom > frame.bottom + 1 || b.top < frame.top - 1)) scrolled = true;
    }
    if (isModal && !one.closest(".q-dialog") && !stop.contains(one)) continue;
    if (!scrolled && !hits(one, b.left + b.width / 2, b.top + b.height / 2))
      found.push(`${name(one)} is covered by ${name(at(b.left + b.width / 2, b.top + b.height / 2) || document.body)}`);
  }

  // What stands over the map stands beside, not over, each other: the licence of its tiles, too. Parts of one card are one.
  const over = [...document.querySelectorAll(
    "#header, #dock, .place.tools, .place.hud > *, .place.prepared > *, .place .stick, .legend, .map-tools, .map-home, section[data-view=plan], .map-source, .leaflet-control-scale"
  )].filter((one) => isSeen(one) && one.getBoundingClientRect().width);
  const clipped = (one) => {
    const place = one.closest(".place"), b = one.getBoundingClientRect();
    const frame = (place && getComputedStyle(place).overflowY !== "visible" ? place : one).getBoundingClientRect();
    return {left: b.left, right: b.right, top: Math.max(b.top, frame.top), bottom: Math.min(b.bottom, frame.bottom)};
  };
  over.forEach((one, i) => over.slice(i + 1).forEach((two) => {
    if (one.contains(two) || two.contains(one)) return;
    const a = clipped(one), b = clipped(two);
    if (Math.min(a.right, b.right) - Math.max(a.left, b.left) > 1 && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 1)
      found.push(`${name(one)} and ${name(two)} overlap`);
  }));
  return found;
}
