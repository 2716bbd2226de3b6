// Stands between the browser and a station that is not reached: then it shows one page that says so.
// It keeps that page and nothing else. Only the opening of a page passes here: sockets, values and
// scripts never do, so nothing old can be taken for new.

const KEPT = "m100link-offline-2";
const PAGE = "/console/offline.html";

self.addEventListener("install", (event) => {
  const page = new Request(PAGE, {cache: "reload", credentials: "same-origin"});
  event.waitUntil(caches.open(KEPT).then((kept) => kept.add(page)).then(() => self.skipWaiting()));
});

self.addEventListener("activate", (event) => {
  event.waitUntil(caches.keys().then((names) => Promise.all(
    names.filter((name) => name.startsWith("m100link-") && name !== KEPT).map((name) => caches.delete(name)))));
});

self.addEventListener("fetch", (event) => {
  if (event.request.mode !== "navigate" || event.request.destination !== "document") return;
  event.respondWith(fetch(event.request).catch(() => caches.match(PAGE)));
});
