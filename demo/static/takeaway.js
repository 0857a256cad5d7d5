/* The download panel: files of a result, files that are made on request, and the menu to share a result. */
'use strict';
(() => {
  const { h, calm, announce } = globalThis.Phy124;

  const size = (bytes) => (bytes < 1e6 ? `${Math.max(1, Math.round(bytes / 1e3))} kB` : `${(bytes / 1e6).toFixed(1)} MB`);
  const GROUPS = { videos: 'Videos', show: 'To show', programs: 'For 3D programs', experts: 'For experts' };
  const LARGE = 100e6;

  function takeaway(element, props, watch, trigger) {
    const making = new Set(), sharing = globalThis.Phy124.sharing = () => share();
    let shown = {}, last = null, opened = null;
    const begin = (kind) => { making.add(last = kind); trigger('prepare', { kind }); };
    const link = ({ label, hint, file, notes = [] }) => h('a', { class: 'file', href: file.url, download: file.orig_name, 'data-name': file.orig_name },
      h('strong', {}, label), h('span', {}, hint), h('em', {}, size(file.size || 0)), ...notes.map((note) => h('small', {}, note)));
    const button = ({ kind, label, hint, about }) => h('button', { type: 'button', class: 'file', 'data-kind': kind, 'aria-busy': making.has(kind) && 'true',
      onclick: (event) => { begin(kind); event.currentTarget.setAttribute('aria-busy', 'true'); event.currentTarget.append(h('progress', { 'aria-label': `Making ${label}` })); } },
    h('strong', {}, label), h('span', {}, hint), h('em', { class: about > LARGE ? 'warn' : '' }, about ? `Make (${about > LARGE ? 'large, ' : ''}about ${size(about)})` : 'Make'),
    making.has(kind) ? h('progress', { 'aria-label': `Making ${label}` }) : null);
    const film = ({ label, file }) => {
      const video = h('video', { src: file.url, loop: true, playsinline: true, autoplay: !calm(), preload: 'auto', tabindex: 0, 'aria-label': label });
      video.muted = true;
      for (const [event, on] of [['pointerenter', true], ['focus', true], ['pointerleave', false]]) video.addEventListener(event, () => { video.controls = on; });
      video.addEventListener('loadedmetadata', () => { video.playbackRate = shown.length < 1 ? 0.5 : 1; });
      return h('figure', { class: 'film' }, video);
    };
    const group = (name, title) => {
      const files = shown.files.filter((each) => each.group === name), offers = shown.offers.filter((each) => each.group === name);
      const bytes = files.reduce((sum, { file }) => sum + (file.size || 0), 0), inside = h('div', { class: 'files' });
      const fill = () => inside.replaceChildren(...(name === 'videos' ? [h('div', { class: 'films' }, ...files.filter(({ file }) => /mp4$/.test(file.orig_name)).map(film))] : []), ...files.map(link), ...offers.map(button),
        ...(name === 'show' && shown.share ? [address(shown.share)] : []));
      if (opened === name) fill();
      const each = [...files.map(({ brief, label, file }) => `${brief || label} ${size(file.size || 0)}`), ...offers.map(({ label }) => label.replace(/^[A-Z](?=[a-z])/, (first) => first.toLowerCase()))];
      const more = name === 'videos' ? `${files.length} ${files.length === 1 ? 'side' : 'sides'}, ${size(bytes)}` : each.length > 3 ? `${each.slice(0, 2).join(', ')}, ${each.length - 2} more` : each.join(', ');
      return h('details', { class: 'fold', name: 'take', 'data-group': name, open: opened === name, ontoggle: (event) => {
        if (event.target.open) { opened = name; fill(); } else if (opened === name) opened = null;
      } }, h('summary', {}, title, h('span', {}, more)), inside);
    };
    const absolute = (path) => new URL(path, document.baseURI).href;
    const copied = (url, at) => navigator.clipboard?.writeText(url).then(() => { at.textContent = 'Copied'; announce('The link is copied.'); });
    const address = ({ link: path, lasts }) => {
      const url = absolute(path), copy = h('button', { type: 'button', class: 'quiet', onclick: () => copied(url, copy) }, 'Copy');
      return h('p', { class: 'shared', role: 'status' }, h('a', { href: url, target: '_blank', rel: 'noopener' }, url), copy, h('span', {}, lasts));
    };

    /* The button next to the player opens the system's share menu or, if there is none, a link and the video. */
    let pop = null;
    const share = () => {
      pop = h('details', { class: 'pop share' }, h('summary', { class: 'filled' }, 'Share'), h('div', { class: 'panel', role: 'group', 'aria-label': 'Share' }));
      pop.addEventListener('toggle', () => { if (pop.open) { if (!shown.share) begin('share'); choices(); } });
      return pop;
    };
    const choices = () => {
      if (!pop?.open) return;
      const url = shown.share && absolute(shown.share.link), video = shown.files?.find(({ group: of }) => of === 'videos')?.file;
      const act = (label, run) => h('button', { type: 'button', disabled: !url, onclick: run }, label);
      const copy = act(url ? 'Copy the link' : 'Making the link …', () => copied(url, copy));
      pop.lastChild.replaceChildren(...(navigator.share ? [act('Send it …', () => navigator.share({ title: 'phy124', url }).catch(() => {}))] : []), copy,
        ...(video ? [h('a', { href: video.url, download: video.orig_name }, 'Save the video')] : []), h('small', {}, shown.message || shown.share?.lasts || ''));
    };

    const show = (value) => {
      if (value.asked && value.result && value.result !== shown.result) return; // the answer is about another result
      if (value.result !== shown.result) making.clear();
      else if (shown.share && !value.share) value = { ...value, share: shown.share };
      making.delete(value.asked);
      shown = value;
      element.replaceChildren(...(value.files ? [h('h2', {}, 'Take away'), ...Object.entries(GROUPS).map(([name, title]) => group(name, title))] : []));
      if (value.message) element.append(h('p', { class: 'message', role: 'alert' }, value.message));
      choices();
      const made = value.asked === last && value.file ? element.querySelector(`[data-name="${value.file}"]`) : null;
      // The file is not opened automatically, because browsers may block downloads that no click requested.
      if (made) { last = null; made.classList.add('new'); made.focus(); }
    };
    watch('value', () => show(props.value || {}));
    show(props.value || {});
    document.addEventListener('phy124-failed', () => {
      if (!making.size) return;
      making.clear();
      show({ ...shown, asked: null, message: 'The server could not make this file. Try again.' });
    });
    return sharing;
  }

  Object.assign(globalThis.Phy124, { takeaway });
})();
