"use strict";
const flight = JSON.parse(document.getElementById("flight").textContent);
const charts = [...document.querySelectorAll(".chart")];
const place = document.getElementById("place");
const time = document.getElementById("time");

function clock(seconds) {
  const whole = Math.floor(seconds), pad = (n) => String(n).padStart(2, "0");
  const hours = Math.floor(whole / 3600), minutes = Math.floor(whole / 60) % 60;
  const rest = pad(whole % 60) + "." + Math.floor((seconds % 1) * 10);
  return hours ? `${hours}:${pad(minutes)}:${rest}` : `${minutes}:${rest}`;
}

// The last point that is not later.
function at(points, t) {
  let low = 0, high = points.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (points[middle][0] <= t) low = middle + 1; else high = middle;
  }
  return points[low - 1];
}

function show(t) {
  const share = 100 * t / flight.duration;
  for (const chart of charts) {
    const cursor = chart.querySelector(".cursor");
    cursor.style.display = "block";
    cursor.style.left = share + "%";
  }
  time.textContent = clock(t);
  flight.lines.forEach((points, number) => {
    const point = at(points, t);
    const value = point && point[1] !== null ? String(Math.round(point[1] * 100) / 100) : "";
    document.getElementById("value" + number).textContent = value;
  });
  const there = at(flight.track, t);
  if (place && there) {
    place.setAttribute("cx", there[1]);
    place.setAttribute("cy", there[2]);
    place.style.display = "block";
  }
}

for (const chart of charts) {
  const follow = (event) => {
    const box = chart.getBoundingClientRect();
    const share = Math.min(1, Math.max(0, (event.clientX - box.left) / box.width));
    show(share * flight.duration);
  };
  chart.addEventListener("pointermove", follow);
  chart.addEventListener("pointerdown", follow);
}
