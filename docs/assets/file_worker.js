// Browsers start no worker of a page that is opened as a file. The search runs in one, so here a hidden frame does its
// work: its global scope gets the messages, and answers with `postMessage`, as a worker does.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      this.frame.title = "search";
      document.body.append(this.frame);
      const scope = this.frame.contentWindow;
      scope.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
      this.ready = new Promise((resolve, reject) => {
        const script = scope.document.createElement("script");
        script.onload = () => resolve(scope);
        script.onerror = reject;
        script.src = url;
        scope.document.body.append(script);
      });
    }
    postMessage(data) {
      this.ready.then((scope) => scope.dispatchEvent(new MessageEvent("message", { data })));
    }
    terminate() {
      this.frame.remove();
    }
  };
}
