/* The panels of the page: progress, viewer, videos, take-away. Each is a function that Gradio's
 * gr.HTML calls once with its element; `watch` tells when Python sends a new value. */
'use strict';
(() => {
  const h = (tag, attributes = {}, ...children) => {
    const node = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) {
      if (name.startsWith('on')) node.addEventListener(name.slice(2), value);
      else if (value === true) node.setAttribute(name, '');
      else if (value !== false && value != null) node.setAttribute(name, value);
    }
    node.append(...children.filter((child) => child != null));
    return node;
  };

  const seconds = (s) => (s < 90 ? `${s.toFixed(s < 9.95 ? 1 : 0)} s` : `${(s / 60).toFixed(1)} min`);
  const size = (bytes) => (bytes < 1e6 ? `${Math.max(1, Math.round(bytes / 1e3))} kB` : `${(bytes / 1e6).toFixed(1)} MB`);

  /* ---- examples ---------------------------------------------------------------------------- */

  async function examples(element, props, watch, trigger) {
    const { examples: names } = await (await fetch('phy124/catalogue.json')).json();
    const button = (name) => h('button', { type: 'button', 'aria-label': `Example: ${name.replace(/_/g, ' ')}`, onclick: () => trigger('pick', { name }) },
      h('img', { src: `phy124/examples/${name}.png`, alt: '', width: 48, height: 48, loading: 'lazy' }));
    element.replaceChildren(h('p', { class: 'examples-title' }, 'Or begin with one of these'), h('div', { class: 'examples' }, ...names.map(button)));
  }

  /* ---- progress: stages with bars, and the run so far as a flip-book ----------------------- */

  function progress(element, props, watch) {
    let frames = [], shown = 0, timer = null;
    const picture = h('img', { alt: 'The motion so far', class: 'glimpse' });
    const flip = () => { if (frames.length) picture.src = frames[shown++ % frames.length]; };
    const bar = (row) => {
      const share = row.reused ? 1 : row.total ? row.done / row.total : 0;
      return h('li', { class: row.reused ? 'stage reused' : share >= 1 ? 'stage full' : share ? 'stage going' : 'stage' },
        h('span', { class: 'stage-name' }, row.name),
        h('span', { class: 'stage-note' }, row.note || (row.total > 1 && row.done ? `${row.done} of ${row.total}` : '')),
        h('progress', { max: 1, value: share, 'aria-label': row.name }));
    };
    const show = () => {
      const value = props.value || { state: 'idle' };
      const begun = value.state !== 'idle' && element.dataset.state !== value.state;
      element.dataset.state = value.state;
      if (value.state === 'idle' || value.state === 'done') {
        clearInterval(timer); timer = null; frames = []; shown = 0;
        element.replaceChildren();
        return;
      }
      for (const glimpse of value.glimpses || []) frames.push(`data:image/jpeg;base64,${glimpse}`);
      const running = value.state === 'running' || value.state === 'waiting';
      if (frames.length && !timer) timer = setInterval(flip, 70);
      if (!frames.length) picture.removeAttribute('src');
      if (!running) { clearInterval(timer); timer = null; frames = []; shown = 0; }
      const left = Math.max(0, value.expected - value.elapsed);
      element.replaceChildren(h('section', { class: `progress ${value.state}`, 'aria-label': 'Progress' },
        running && frames.length ? h('figure', {}, picture, h('figcaption', {}, 'Preview, growing')) : null,
        h('div', { class: 'progress-body' },
          value.message ? h('p', { class: 'message', role: 'status' }, value.message) : null,
          running ? h('p', { class: 'clock' }, value.state === 'waiting' ? 'Waiting for the device'
            : left > 0.5 ? `${seconds(value.elapsed)} so far, about ${seconds(left)} to go` : `${seconds(value.elapsed)} so far, nearly there`) : null,
          running ? h('ol', { class: 'stages' }, ...(value.stages || []).map(bar)) : null)));
      flip();
      if (begun) element.scrollIntoView({ block: 'nearest', behavior: 'smooth' });
    };
    watch('value', show);
    show();
  }

  /* ---- the 4D viewer ----------------------------------------------------------------------- */

  function viewer(element, props, watch) {
    let player = null, current = null;
    const show = async () => {
      const url = props.value && props.value.pack && props.value.pack.url;
      if (url === current) return;
      current = url;
      if (player) { player.dispose(); player = null; }
      if (!url) return element.replaceChildren(welcome());
      const host = h('div', { class: 'viewer-host' });
      element.replaceChildren(host);
      const answer = await fetch(url);
      if (!answer.ok) { host.textContent = 'The result is no longer on the server. Generate it again.'; return; }
      const bytes = new Uint8Array(await answer.arrayBuffer());
      if (current !== url) return;
      player = await Phy124Player.mount(host, bytes);
      if (player && document.body.classList.contains('dark')) {
        player.find('background').value = 'dark';
        player.find('background').dispatchEvent(new Event('change'));
      }
      element.player = player;
    };
    watch('value', show);
    show();
  }

  const welcome = () => h('div', { class: 'welcome' },
    h('img', { src: 'phy124/previews/press.webp', alt: '' }),
    h('h2', {}, 'See it move'),
    h('p', {}, 'Choose a picture of one object and what should happen to it. Here it will turn, bend and bounce in 3D, as its material would.'));

  /* ---- videos ------------------------------------------------------------------------------ */

  function videos(element, props, watch) {
    const show = () => {
      const films = (props.value && props.value.films) || [];
      element.replaceChildren(films.length
        ? h('div', { class: 'films' }, ...films.map(film))
        : h('p', { class: 'empty' }, 'The videos of each view appear here.'));
    };
    const film = ({ name, file }) => {
      const video = h('video', { src: file.url, loop: true, playsinline: true, preload: 'auto', tabindex: 0, 'aria-label': `Video, ${name}` });
      video.muted = true;
      for (const [event, on] of [['pointerenter', true], ['focus', true], ['pointerleave', false]]) {
        video.addEventListener(event, () => { video.controls = on; });
      }
      if (!matchMedia('(prefers-reduced-motion: reduce)').matches) video.autoplay = true;
      return h('figure', { class: 'film' }, video, h('figcaption', {}, name));
    };
    watch('value', show);
    show();
  }

  /* ---- take-away --------------------------------------------------------------------------- */

  function takeaway(element, props, watch, trigger) {
    let asked = null;
    const show = () => {
      const value = props.value || {};
      const link = ({ label, hint, file }) => h('a', { class: 'file', href: file.url, download: file.orig_name, 'data-name': file.orig_name },
        h('strong', {}, label), h('span', {}, hint), h('em', {}, size(file.size || 0)));
      const button = ({ kind, label, hint }) => h('button', { type: 'button', class: 'file', 'data-kind': kind,
        onclick: (event) => { asked = kind; event.currentTarget.setAttribute('aria-busy', 'true'); trigger('prepare', { kind }); } },
      h('strong', {}, label), h('span', {}, hint), h('em', {}, 'Make'));
      element.replaceChildren(value.files ? h('div', { class: 'files' }, ...value.files.map(link), ...value.offers.map(button))
        : h('p', { class: 'empty' }, 'Videos, the moving Gaussians and the scene can be taken away from here.'));
      if (value.message) element.append(h('p', { class: 'message', role: 'alert' }, value.message));
      const made = asked && value.made === asked ? element.querySelector(`[data-name="${value.file}"]`) : null;
      // Not opened by itself: browsers may block downloads that no click has asked for.
      if (made) { asked = null; made.classList.add('new'); made.focus(); }
    };
    watch('value', show);
    show();
  }

  globalThis.Phy124 = Object.assign(globalThis.Phy124 || {}, { h, examples, progress, viewer, videos, takeaway });
})();
