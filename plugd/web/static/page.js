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
    for (const [command, chosen] of Object.entries(news.pressed))
      for (const button of document.querySelectorAll(`button[data-command=${command}]`))
        button.setAttribute("aria-pressed", String(button.dataset.value === chosen));
    for (const [id, value] of Object.entries(news.values)) {
      const input = byId(id);
      if (!input || document.activeElement === input || input.dataset.touched) continue;
      if (input.type === "checkbox") input.checked = value;
      else input.value = value;
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
      if (reply.status === 401) byId("access").open = true;
      answer.textContent = told.message;
    } catch {
      answer.textContent = "plugd does not answer; is it running?";
    }
    answer.className = ok ? "answer good" : "answer bad";
    answer.scrollIntoView({ block: "nearest" });
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

  const week = (form) => {
    const asked = {};
    for (const input of form.querySelectorAll("input")) {
      const [day, key] = input.id.split("-");
      const value = input.type === "checkbox" ? input.checked : input.value;
      if (value) (asked[day] ??= {})[key] = key === "minimum_pct" ? Number(value) : value;
    }
    return JSON.stringify(asked);
  };

  const PAYLOAD = { trip, week };

  const untouch = (form) => {
    for (const input of form?.elements ?? []) delete input.dataset.touched;
  };

  document.addEventListener("submit", async (event) => {
    event.preventDefault();
    const form = event.target;
    if (form.id === "token-form") {
      if (/[^\x20-\xff]/.test(byId("token").value)) { // a header cannot carry it, and fetch would only throw
        byId("answer").className = "answer bad";
        byId("answer").textContent = "that is not a token this page can send; use letters, digits and signs of ASCII";
        return;
      }
      localStorage.setItem(TOKEN, byId("token").value);
      byId("token").value = "";
      byId("access").open = false;
      byId("answer").className = "answer good";
      byId("answer").textContent = "The token is kept in this browser.";
      return;
    }
    const command = form.dataset.command;
    const payload = PAYLOAD[command]?.(form) ?? form.elements.value.value;
    const ok = await send(command, payload);
    if (ok) untouch(form);
    if (ok && (command === "trip" || command === "soc")) form.reset();
  });

  document.addEventListener("click", (event) => {
    const button = event.target.closest("button");
    const { command, value, clear } = button?.dataset ?? {};
    if (clear) send("trip", JSON.stringify({ date: clear, clear: true }));
    if (command) {
      untouch(button.form);
      send(command, value);
    }
  });

  if (byId("access") && !localStorage.getItem(TOKEN)) byId("access").open = true;
  document.addEventListener("input", (event) => { event.target.dataset.touched = "yes"; });
  document.addEventListener("visibilitychange", () => { if (!document.hidden) refresh(); });
  setInterval(() => { if (!document.hidden) refresh(); }, EVERY_MS);
})();
