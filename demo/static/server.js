/* The page's connection to the server: running jobs, connections that are lost for a while, and a server that
 * no longer has this visitor's files, because it was restarted or the page was disconnected for too long.
 *
 * Events of the document: "phy124-forgotten", and "phy124-failed" if a request was answered by an error. */
'use strict';
(() => {
  const ENDLESS = ['waiting', 'running', 'lost'];
  const STORED = 'phy124-visitor', OFTEN = 15e3, AGAIN = 1500;
  const ASKS = /gradio_api\/(run|queue\/join)/;
  const LOST = 'The connection to the server was lost. Reconnecting …';
  const FORGOTTEN = 'The server was restarted, or this page was disconnected for too long, so the server no longer has your files. '
    + 'The result stays visible until you leave the page; to download files, generate it again.';

  const pause = (ms) => new Promise((done) => setTimeout(done, ms));
  const ask = globalThis.fetch.bind(globalThis);
  const tell = (name) => document.dispatchEvent(new Event(name));

  /** Request a job's progress until the job ends, even if connections are lost; `tell` returns false to give up. */
  async function follow(job, tell, end) {
    let seen = 0;
    for (;;) {
      let told = { state: 'lost' };
      try {
        const answer = await fetch(`phy124/jobs/${job}?seen=${seen}`);
        if (answer.ok || answer.status === 404) told = await answer.json();
      } catch { /* the state reports it */ }
      seen += told.glimpses ? told.glimpses.length : 0;
      if (tell(told) === false) return;
      if (told.state === 'gone') await look();
      if (!ENDLESS.includes(told.state)) return end(told);
      await pause(told.state === 'lost' ? AGAIN : told.state === 'waiting' ? 600 : 250);
    }
  }

  /** Requests of a panel to the server, one at a time; only the latest request waits. */
  class Questions {
    constructor(trigger) { Object.assign(this, { trigger, pending: null, next: null }); }

    /** Return whether an event waits, or was sent and not yet answered. */
    holds(event) { return this.pending === event || this.next?.[0] === event; }

    ask(event, what) {
      if (this.pending) { this.next = [event, what]; return; }
      this.pending = event;
      this.trigger(event, what);
    }

    /** Handle an answer of the server; return whether a waiting request makes the answer outdated. */
    answered() {
      const { next } = this;
      Object.assign(this, { pending: null, next: null });
      if (next) this.ask(...next);
      return Boolean(next);
    }
  }

  /* ---- whether the server answers, and has this visitor's files ------------------------------------------- */

  const server = { forgot: false, look };

  /** Return whether the server answers; the request also keeps this visitor's files. */
  async function look() {
    let visitor;
    try { ({ visitor } = await (await ask('phy124/here')).json()); } catch { return false; }
    const known = sessionStorage.getItem(STORED);
    if (visitor) sessionStorage.setItem(STORED, visitor); else sessionStorage.removeItem(STORED);
    if (known && visitor !== known) forget();
    return true;
  }

  function forget() {
    server.forgot = true;
    notice(FORGOTTEN, true);
    tell('phy124-forgotten');
  }

  /** Resolves when the server answers again. */
  let back = null;
  function answering() {
    back ??= (async () => {
      notice(LOST);
      while (!await look()) await pause(AGAIN);
      if (notice.text === LOST) notice('');
      back = null;
    })();
    return back;
  }

  /** Gradio reloads the page when one of its requests is lost, which would remove everything shown. Therefore
   * these requests wait until the server answers. */
  globalThis.fetch = async (address, options) => {
    if (!ASKS.test(String(address?.url ?? address))) return ask(address, options);
    for (;;) {
      try {
        const answer = await ask(address, options);
        if (!answer.ok) tell('phy124-failed');
        return answer;
      } catch (error) {
        if (error.name === 'AbortError') throw error;
        await answering();
      }
    }
  };

  setInterval(look, OFTEN);
  document.addEventListener('visibilitychange', () => { if (!document.hidden) look(); });
  look();

  /* ---- a line above the page ------------------------------------------------------------------ */

  const line = document.createElement('p');
  Object.assign(line, { id: 'server-notice', hidden: true });
  line.setAttribute('role', 'status');

  function notice(text, closes = false) {
    notice.text = text;
    if (!line.isConnected) (document.querySelector('.gradio-container') || document.body).append(line);
    line.hidden = !text;
    line.textContent = text;
    if (!closes) return;
    const close = document.createElement('button');
    Object.assign(close, { type: 'button', className: 'quiet', textContent: 'Close', onclick: () => notice('') });
    line.append(close);
  }

  globalThis.Phy124 = Object.assign(globalThis.Phy124 || {}, { follow, pause, server, Questions });
})();
