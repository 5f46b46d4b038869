"use strict";
// What all parts share: the data of the page, short names for the document, and messages.

const data = JSON.parse(document.getElementById("data").textContent);
const one = (selector, within = document) => within.querySelector(selector);
const all = (selector, within = document) => [...within.querySelectorAll(selector)];
const map = one("#map");
const stage = one("#stage");
const calm = () => matchMedia("(prefers-reduced-motion: reduce)").matches;
const listeners = {};

function on(message, listener) {
  (listeners[message] ??= []).push(listener);
}

function tell(message, ...values) {
  for (const listener of listeners[message] ?? []) listener(...values);
}

function say(words) {
  one("#spoken").textContent = words;
}

function svg(name, attributes) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

function clock(seconds) {
  const whole = Math.round(seconds);
  const pad = (number) => String(number).padStart(2, "0");
  const hours = Math.floor(whole / 3600), minutes = Math.floor(whole / 60) % 60;
  return hours ? `${hours}:${pad(minutes)}:${pad(whole % 60)}` : `${minutes}:${pad(whole % 60)}`;
}

function numbers(text) {
  return text.split(" ").map(Number);
}

document.documentElement.classList.add("scripted");

// Day or night: as the system has it until somebody chooses.
{
  const button = one("#theme");
  const isDark = () => {
    const chosen = document.documentElement.dataset.theme;
    return chosen ? chosen === "night" : matchMedia("(prefers-color-scheme: dark)").matches;
  };
  const show = () => { button.textContent = isDark() ? "Light" : "Dark"; };
  button.hidden = false;
  button.addEventListener("click", () => {
    document.documentElement.dataset.theme = isDark() ? "day" : "night";
    show();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", show);
  show();
}
