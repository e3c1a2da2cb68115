"use strict";
// Keeps the page fresh and sends what is set. Everything shown comes drawn and escaped from plugd itself.
(() => {
  const EVERY_MS = 2000;
  const TOKEN = "plugd-token";
  const byId = (id) => document.getElementById(id);
  const shown = {};
  let version = document.body.dataset.version;
  let failures = 0;

  const setText = (id, words) => {
    const element = byId(id);
    if (element && element.textContent !== words) element.textContent = words;
  };

  const refresh = async () => {
    try {
      const reply = await fetch(`/live?v=${version}`, { cache: "no-store" });
      if (reply.status === 200) show(await reply.json());
      else if (reply.status !== 204) throw new Error(String(reply.status));
      failures = 0;
      setText("stale", "");
    } catch {
      failures += 1;
      if (failures > 2) setText("stale", " · plugd does not answer; the figures are old");
    }
  };

  const show = (news) => {
    version = String(news.version);
    setText("status", news.status);
    setText("at", news.at);
    setText("reason", news.reason);
    for (const [id, html] of Object.entries(news.html)) {
      const element = byId(id);
      if (element && shown[id] !== html) {
        if (shown[id] !== undefined || element.innerHTML !== html) element.innerHTML = html;
        shown[id] = html;
      }
    }
    for (const button of document.querySelectorAll("[data-mode]"))
      button.setAttribute("aria-pressed", String(button.dataset.mode === news.mode));
    for (const [id, value] of Object.entries(news.values)) {
      const input = byId(id);
      if (input && document.activeElement !== input && !input.dataset.touched) input.value = value;
    }
  };

  const send = async (command, payload) => {
    const answer = byId("answer");
    answer.className = "answer";
    answer.textContent = "…";
    let ok = false;
    try {
      const reply = await fetch(`/command/${command}`, {
        method: "POST",
        headers: { "Content-Type": "text/plain", "X-Plugd-Token": localStorage.getItem(TOKEN) || "" },
        body: payload,
      });
      const told = await reply.json();
      ok = told.ok;
      answer.textContent = told.message;
    } catch {
      answer.textContent = "plugd does not answer; is it running?";
    }
    answer.className = ok ? "answer good" : "answer bad";
    refresh();
    return ok;
  };

  const trip = (form) => {
    const asked = { date: form.elements.date.value };
    if (form.elements.away.checked) asked.away = true;
    if (form.elements.minimum_pct.value) asked.minimum_pct = Number(form.elements.minimum_pct.value);
    if (form.elements.ready_by.value) asked.ready_by = form.elements.ready_by.value;
    return JSON.stringify(asked);
  };

  document.addEventListener("submit", async (event) => {
    event.preventDefault();
    const form = event.target;
    if (form.id === "token-form") {
      localStorage.setItem(TOKEN, byId("token").value);
      byId("token").value = "";
      byId("answer").className = "answer good";
      byId("answer").textContent = "The token is kept in this browser.";
      return;
    }
    const command = form.dataset.command;
    const ok = await send(command, command === "trip" ? trip(form) : form.elements.value.value);
    for (const input of form.elements) delete input.dataset.touched;
    if (ok && (command === "trip" || command === "soc")) form.reset();
  });

  document.addEventListener("click", (event) => {
    const { mode, clear } = event.target.closest("button")?.dataset ?? {};
    if (mode) send("mode", mode);
    if (clear) send("trip", JSON.stringify({ date: clear, clear: true }));
  });

  document.addEventListener("input", (event) => { event.target.dataset.touched = "yes"; });
  document.addEventListener("visibilitychange", () => { if (!document.hidden) refresh(); });
  setInterval(() => { if (!document.hidden) refresh(); }, EVERY_MS);
})();
