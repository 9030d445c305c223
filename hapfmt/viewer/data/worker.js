// The Worker: a session behind messages.
import { Host } from './host.js';

const host = new Host((message, buffers) => self.postMessage(message, buffers));
self.onmessage = ({ data }) => host.take(data);
