/* A form for every setting of a scene, built from the scene's own JSON schema. The form changes the data
 * that it was drawn from.
 *
 *   const form = new Phy124.Form(schema, (sections) => {}); form.draw(data);
 */
'use strict';
(() => {
  const { h } = globalThis.Phy124;
  const clone = (data) => JSON.parse(JSON.stringify(data));
  const words = (name) => name.replace(/_/g, ' ').replace(/^./, (c) => c.toUpperCase());

  class Form {
    /** `changed` is called after each change; its argument states whether sections were added or removed.
     * `first` is shown before the sections, `tools` after the sections. */
    constructor(schema, changed, first = '', tools = '') {
      Object.assign(this, { schema, changed });
      this.body = h('div', { class: 'form' });
      this.contents = h('nav', { 'aria-label': 'Sections' });
      const search = h('input', { type: 'search', placeholder: 'Search', 'aria-label': 'Search the settings', oninput: () => this.search(search.value) });
      this.element = h('dialog', { class: 'more', 'aria-label': 'Every setting' }, h('header', {}, h('h2', {}, 'Every setting'), search,
        h('button', { type: 'button', onclick: () => this.element.close() }, 'Done')), h('div', { class: 'more-body' }, this.contents, h('div', { class: 'sections', tabindex: 0 }, first, this.body)), h('footer', {}, tools));
    }

    /** Show the dialog. */
    open() {
      this.element.showModal();
      this.draw(this.data);
    }

    /** Show the scene's data once the dialog is open; do not replace text that is being typed. */
    draw(data) {
      this.data = data;
      if (!data || !this.element.open || this.body.contains(document.activeElement)) return;
      this.body.replaceChildren(this.fields(this.schema, data, ['description', 'accuracy']));
      const sections = [...this.body.firstChild.children].filter((child) => child.matches('fieldset'));
      this.contents.replaceChildren(...sections.map((section) => h('button', { type: 'button', onclick: () => section.scrollIntoView({ block: 'start' }) }, section.firstChild.textContent)));
    }

    /** Show only the settings whose name or description contains a text. */
    search(text) {
      const fits = (field) => field.textContent.toLowerCase().includes(text.trim().toLowerCase());
      for (const field of this.body.querySelectorAll('.leaf')) field.hidden = !fits(field);
      for (const section of this.body.querySelectorAll('fieldset')) section.hidden = Boolean(text) && !section.querySelector('.leaf:not([hidden])');
    }

    resolve(schema) {
      return schema.$ref ? { ...this.schema.$defs[schema.$ref.split('/').pop()], ...schema, $ref: undefined } : schema;
    }

    fields(schema, data, without = []) {
      const box = h('div', { class: 'fields' });
      for (const [name, given] of Object.entries(schema.properties)) {
        if (without.includes(name) || 'const' in given) continue;
        box.append(this.field(name, this.resolve(given), data));
      }
      return box;
    }

    field(name, schema, data) {
      const optional = schema.anyOf && schema.anyOf.some((s) => s.type === 'null');
      const choices = (schema.anyOf || schema.oneOf || []).filter((s) => s.type !== 'null').map((s) => this.resolve(s));
      if (schema.discriminator) return this.variant(name, schema, data);
      if (schema.type === 'array' && schema.items && schema.items.discriminator) return this.list(name, schema, data);
      if (choices.length === 1) return this.leaf(name, { ...choices[0], description: schema.description }, data, optional);
      const names = choices.find((s) => s.enum), table = choices.find((s) => s.properties);
      if (names && table) return this.leaf(name, names, data);
      if (schema.properties) return this.section(name, this.fields(schema, data[name]));
      return this.leaf(name, schema, data, optional);
    }

    section(name, ...children) { return h('fieldset', {}, h('legend', {}, words(name)), ...children); }

    /** Create the field for a section that has one of several kinds, such as a material's law. */
    variant(name, schema, data) {
      const tag = schema.discriminator.propertyName, kinds = Object.keys(schema.discriminator.mapping);
      const of = (kind) => this.resolve({ $ref: schema.discriminator.mapping[kind] });
      const pick = h('select', { 'aria-label': `${words(name)}: ${tag}`, onchange: (event) => {
        data[name] = this.fresh(of(event.target.value)); this.changed(true);
      } }, ...kinds.map((kind) => h('option', { value: kind, selected: kind === data[name][tag] }, words(kind))));
      const chosen = of(data[name][tag]);
      return this.section(name, pick, h('p', { class: 'hint' }, chosen.description || ''), this.fields(chosen, data[name]));
    }

    /** Create the field for a list of sections, each of one of several kinds: forces, boundaries. */
    list(name, schema, data) {
      const { mapping, propertyName: tag } = schema.items.discriminator;
      const items = data[name].map((item, index) => h('fieldset', { class: 'item' }, h('legend', {}, words(item[tag])),
        h('button', { type: 'button', class: 'remove', 'aria-label': `Remove ${item[tag]}`, onclick: () => { data[name].splice(index, 1); this.changed(true); } }, '×'),
        this.fields(this.resolve({ $ref: mapping[item[tag]] }), item)));
      const add = h('select', { 'aria-label': `Add to ${name}`, onchange: (event) => {
        if (event.target.value) { data[name].push(this.fresh(this.resolve({ $ref: mapping[event.target.value] }))); this.changed(true); }
      } }, h('option', { value: '' }, 'Add …'), ...Object.keys(mapping).map((kind) => h('option', { value: kind }, words(kind))));
      return this.section(name, ...items, add);
    }

    /** Create a section with the defaults of its kind, because the values of another kind have another meaning. */
    fresh(schema) {
      const made = {};
      for (const [name, info] of Object.entries(schema.properties)) {
        if ('const' in info) made[name] = info.const;
        else if ('default' in info && info.default !== null) made[name] = clone(info.default);
      }
      return made;
    }

    leaf(name, schema, data, optional = false) {
      const hint = schema.description || '', value = data[name];
      const set = (now) => { if (now === null && optional) delete data[name]; else data[name] = now; this.changed(false); };
      return h('label', { class: 'leaf', title: hint }, h('span', {}, words(name)), this.input(name, schema, value, set, optional), hint ? h('small', {}, hint) : null);
    }

    input(name, schema, value, set, optional) {
      if (schema.enum) {
        return h('select', { onchange: (event) => set(event.target.value) }, ...(schema.enum.includes(value) ? [] : [h('option', { selected: true }, 'custom')]),
          ...schema.enum.map((choice) => h('option', { value: choice, selected: choice === value }, choice)));
      }
      if (schema.type === 'boolean' && optional) {
        return h('select', { onchange: (event) => set({ yes: true, no: false }[event.target.value] ?? null) },
          ...[['automatic', null], ['yes', true], ['no', false]].map(([word, choice]) => h('option', { selected: choice === (value ?? null) }, word)));
      }
      if (schema.type === 'boolean') return h('input', { type: 'checkbox', checked: value, onchange: (event) => set(event.target.checked) });
      if (schema.type === 'array' && schema.items && schema.items.enum) return this.several(name, schema, value, set);
      if (schema.type === 'array' && schema.prefixItems) return this.vector(name, schema, value, set);
      if (schema.type === 'number' || schema.type === 'integer') {
        return h('input', { type: 'number', step: schema.type === 'integer' ? 1 : 'any', min: schema.minimum ?? schema.exclusiveMinimum, max: schema.maximum ?? schema.exclusiveMaximum,
          value: value ?? '', placeholder: optional ? 'automatic' : '', onchange: (event) => set(event.target.value === '' ? null : Number(event.target.value)) });
      }
      if (schema.format === 'path') return this.upload(name, value, set);
      if (schema.type === 'string') return h('input', { type: 'text', value: value ?? '', onchange: (event) => set(event.target.value) });
      return h('textarea', { rows: 2, spellcheck: 'false', onchange: (event) => {
        try { set(event.target.value.trim() ? JSON.parse(event.target.value) : null); event.target.setCustomValidity(''); } catch { event.target.setCustomValidity('This text is not valid JSON.'); event.target.reportValidity(); }
      } }, value == null ? '' : JSON.stringify(value));
    }

    /** Create the field for a picture file; the file is sent before its name is set. */
    upload(name, value, set) {
      const input = h('input', { type: 'file', accept: 'image/png,image/jpeg,image/webp', 'aria-label': words(name), onchange: async () => {
        const form = new FormData();
        form.append('files', input.files[0]);
        const answer = await fetch('gradio_api/upload', { method: 'POST', body: form }).catch(() => null);
        if (answer && answer.ok) set((await answer.json())[0]);
        else { input.setCustomValidity(answer ? await answer.text() : 'The connection was lost.'); input.reportValidity(); }
      } });
      return h('span', {}, input, value ? h('small', {}, 'A picture was sent.') : null);
    }

    several(name, schema, value, set) {
      return h('div', { class: 'several', role: 'group', 'aria-label': words(name) }, ...schema.items.enum.map((choice) => h('label', {}, h('input', { type: 'checkbox', checked: value.includes(choice),
        onchange: (event) => set(schema.items.enum.filter((c) => (c === choice ? event.target.checked : value.includes(c)))) }), choice)));
    }

    vector(name, schema, value, set) {
      return h('div', { class: 'vector', role: 'group', 'aria-label': words(name) }, ...schema.prefixItems.map((_, i) => h('input', { type: 'number', step: 'any', 'aria-label': `${words(name)} ${'xyz'[i] || i}`, value: value ? value[i] : 0,
        onchange: (event) => { const next = [...(value || [0, 0, 0])]; next[i] = Number(event.target.value); set(next); value = next; } })));
    }
  }

  Object.assign(globalThis.Phy124, { Form, clone, words });
})();
