/* Scenes in links: the editor creates links, and the page starts with the scene in its address. */
'use strict';
(() => {
  const through = async (bytes, stream) => new Uint8Array(await new Response(new Blob([bytes]).stream().pipeThrough(stream)).arrayBuffer());

  /** Encode a scene as part of an address: JSON, deflated, in the variant of base64 for addresses. */
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
