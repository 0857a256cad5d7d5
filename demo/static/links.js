/* Scenes in links: the editor makes them, and the page begins with the scene of its address. */
'use strict';
(() => {
  const through = async (bytes, stream) => new Uint8Array(await new Response(new Blob([bytes]).stream().pipeThrough(stream)).arrayBuffer());

  /** A scene as part of an address: JSON, deflated, base64 of the kind that addresses take. */
  async function asLink(data) {
    const bytes = await through(new TextEncoder().encode(JSON.stringify(data)), new CompressionStream('deflate-raw'));
    const text = btoa(String.fromCharCode(...bytes)).replace(/\+/g, '-').replace(/\//g, '_').replace(/=+$/, '');
    return `${location.origin}${location.pathname}#scene=${text}`;
  }

  async function shared() {
    const found = /^#scene=([\w-]{1,20000})$/.exec(location.hash);
    if (!found) return null;
    try {
      const bytes = Uint8Array.from(atob(found[1].replace(/-/g, '+').replace(/_/g, '/')), (c) => c.charCodeAt(0));
      return JSON.parse(new TextDecoder().decode(await through(bytes, new DecompressionStream('deflate-raw'))));
    } catch { return null; }
  }

  Object.assign(globalThis.Phy124, { asLink, shared });
})();
