// Pages opened as files may start no worker, and the search is one: here it runs in a hidden frame instead.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      this.frame = document.body.appendChild(Object.assign(document.createElement("iframe"), { hidden: true }));
      this.scope = this.frame.contentWindow;
      window.addEventListener("message", (event) => {
        if (event.source !== this.scope) return;
        const told = new MessageEvent("message", { data: event.data });
        this.dispatchEvent(told);
        if (this.onmessage) this.onmessage(told);
      });
      const scope = this.scope.document;
      scope.open();
      scope.write(`<script>
        const loaded = (url) => new Promise((done, failed) => {
          const script = Object.assign(document.createElement("script"), { src: url, onload: done, onerror: failed });
          document.head.appendChild(script);
        });
        importScripts = (...urls) => urls.reduce((before, url) => before.then(() => loaded(url)), Promise.resolve());
        postMessage = (data) => parent.postMessage(data, "*");
      <\/script><script src="${url}"><\/script>`);
      scope.close();
      this.ready = new Promise((done) => this.scope.addEventListener("load", done));
    }
    postMessage(data) {
      this.ready.then(() => this.scope.dispatchEvent(new MessageEvent("message", { data })));
    }
    terminate() {
      this.frame.remove();
    }
  };
}
