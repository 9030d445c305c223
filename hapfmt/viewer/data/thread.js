// What looks like a Worker and works in the same thread: for programs without one.
import { Host } from './host.js';

export class Thread {
  constructor() {
    this.onmessage = null;
    this.host = new Host((message) => queueMicrotask(() => this.onmessage?.({ data: message })));
  }

  postMessage(message) {
    queueMicrotask(() => this.host.take(message));
  }

  terminate() {
    this.host.take({ call: 'close' });
    this.onmessage = null;
  }
}
