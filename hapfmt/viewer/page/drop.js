// Files dropped onto the page are added, or replace the open ones.
import { element } from './dom.js';

export function acceptDrops(app) {
  const zone = (text, replace) => element('div', {
    class: 'zone',
    ondragenter: (event) => event.currentTarget.classList.add('over'),
    ondragleave: (event) => event.currentTarget.classList.remove('over'),
    ondrop: (event) => take(event, replace),
  }, text);
  const veil = element('div', { id: 'drop', hidden: true }, zone('Add to the view', false), zone('Replace the open files', true));
  document.body.append(veil);
  const take = (event, replace) => {
    event.preventDefault();
    event.stopPropagation();
    veil.hidden = true;
    for (const zoneElement of veil.children) zoneElement.classList.remove('over');
    app.openFiles([...event.dataTransfer.files], replace);
  };
  document.addEventListener('dragover', (event) => {
    if (!event.dataTransfer.types.includes('Files')) return;
    event.preventDefault();
    veil.hidden = false;
    veil.firstChild.hidden = !app.state.entries.length;
  });
  document.addEventListener('dragleave', (event) => {
    if (!event.relatedTarget) veil.hidden = true;
  });
  document.addEventListener('drop', (event) => {
    if (event.dataTransfer.files.length) take(event, !app.state.entries.length);
  });
}
