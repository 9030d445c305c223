// The files of the page, as its element `files` lists them: -> [{ name, url } | { name, bytes }].
export function listSources() {
  const listed = JSON.parse(document.getElementById('files').textContent);
  return listed.map(({ name, url, inline }) => {
    if (inline === undefined) return { name, url: new URL(url, document.baseURI).href };
    return { name, bytes: readInline(document.getElementById(inline)) };
  });
}

function readInline(element) {
  const text = atob(element.textContent);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes;
}
