// The service worker of the playground: after the first visit, the page works without a network.

const FILES = [] /*FILES*/, VERSION = "" /*VERSION*/;
const NAME = `thorvaldc playground ${VERSION}`;

async function removeOthers() {
  for (const name of await caches.keys()) if (name.startsWith("thorvaldc playground") && name !== NAME) await caches.delete(name);
}

self.addEventListener("install", (event) => event.waitUntil(caches.open(NAME).then((cache) => cache.addAll(FILES))));
self.addEventListener("activate", (event) => event.waitUntil(removeOthers()));
self.addEventListener("fetch", (event) => {
  event.respondWith(caches.match(event.request, { cacheName: NAME }).then((kept) => kept ?? fetch(event.request)));
});
