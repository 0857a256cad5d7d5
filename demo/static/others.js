/* Pictures of the further objects of a scene. The scene editor lists the objects that take a picture (event
 * "phy124-objects") and receives the chosen pictures ("phy124-object"), which are stored in the scene. */
'use strict';
(() => {
  const { h, listen, View } = globalThis.Phy124;
  const HINT = 'Picture of this object; without a picture, the object is a copy of the first object.';

  async function others(element, props, watch, trigger) {
    const offer = await (await fetch('phy124/catalogue.json')).json();
    const panel = new Others(element, offer.limits, trigger);
    document.addEventListener('phy124-objects', (event) => panel.draw(event.detail));
    panel.draw(globalThis.Phy124.objects || []);
    watch('value', () => panel.take(props.value));
    listen(panel);
    document.addEventListener('phy124-forgotten', () => panel.each((slot) => slot.restore()));
  }

  class Others {
    constructor(element, limits, trigger) { Object.assign(this, { element, limits, trigger, slots: new Map(), options: {} }); }

    /** Create a slot for each object that takes a picture; keep existing slots. */
    draw(objects) {
      const slots = new Map(objects.map(({ name }) => [name, this.slots.get(name) || this.slot(name)]));
      if ([...slots.keys()].join() !== [...this.slots.keys()].join()) {
        const all = [...slots.values()];
        this.element.replaceChildren(...(all.length ? [h('p', { class: 'examples-title' }, 'Other objects: each is a copy of the first unless you add a picture'),
          h('div', { class: 'views' }, ...all.map((slot) => slot.element)), ...all.map((slot) => slot.status)] : []));
      }
      this.slots = slots;
      for (const { name, picture } of objects) slots.get(name).match(picture || null);
    }

    slot(name) {
      this.options[name] = { description: HINT };
      return new Slot(name, this);
    }

    tell(told) {
      for (const [name, picture] of Object.entries(told)) {
        const slot = this.slots.get(name);
        if (!slot || slot.path === picture) continue;
        slot.path = picture;
        document.dispatchEvent(new CustomEvent('phy124-object', { detail: { name, picture } }));
      }
    }

    each(act) { this.slots.forEach(act); }

    take(value) { this.slots.get(value?.answer?.option)?.take(value.answer); }
  }

  class Slot extends View {
    path = null;

    /** Show the picture that the scene currently has, also after a reload or an undo step. */
    match(picture) {
      if (picture === this.path) return;
      this.path = picture;
      this.clear();
      if (picture) this.look(picture);
    }

    /** Send the picture again if this page still has it, because the server no longer has the picture. */
    restore() {
      const { file } = this, had = !this.shown.hidden || this.following;
      if (!file && !had) return;
      this.clear();
      this.tell(null);
      if (file) return this.choose(file);
      this.say('The server no longer has this picture. Choose it again.', true);
    }
  }

  Object.assign(globalThis.Phy124, { others });
})();
