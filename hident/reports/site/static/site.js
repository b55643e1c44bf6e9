"use strict";
// All pages are whole without this: it adds a choice of the theme, details on hover and focus, filters and a zoom.

(() => {
  const root = document.documentElement;

  // What is kept is a comfort: a browser may refuse it, as some do for files.
  function kept(name, value) {
    try {
      if (value === undefined) return localStorage.getItem(name);
      localStorage.setItem(name, value);
    } catch {
      return null;
    }
    return value;
  }

  function theme() {
    const chosen = kept("theme");
    if (chosen === "light" || chosen === "dark") root.dataset.theme = chosen;
  }
  theme();

  function addTheme() {
    const button = document.createElement("button");
    button.type = "button";
    button.className = "theme";
    const isDark = () =>
      (root.dataset.theme || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light")) === "dark";
    const name = () => { button.textContent = isDark() ? "Light" : "Dark"; };
    button.addEventListener("click", () => {
      root.dataset.theme = isDark() ? "light" : "dark";
      kept("theme", root.dataset.theme);
      name();
    });
    name();
    document.querySelector("body > header").append(button);
  }

  // The details of a number: shown on hover and on keyboard focus, kept by a click, closed by Escape.
  function addDetails() {
    if (!HTMLElement.prototype.showPopover) return;
    let pinned = null;
    let timer = 0;

    function place(detail, button) {
      const at = button.getBoundingClientRect();
      const size = detail.getBoundingClientRect();
      const gap = 6;
      const left = Math.max(gap, Math.min(at.left, innerWidth - size.width - gap));
      const below = at.bottom + gap;
      const above = at.top - size.height - gap;
      const top = below + size.height <= innerHeight || above < 0 ? below : above;
      detail.style.margin = "0";
      detail.style.inset = "auto";
      detail.style.left = `${left}px`;
      detail.style.top = `${Math.max(gap, Math.min(top, innerHeight - size.height - gap))}px`;
    }

    for (const button of document.querySelectorAll("button[popovertarget]")) {
      const detail = document.getElementById(button.getAttribute("popovertarget"));
      const isOpen = () => detail.matches(":popover-open");
      const show = () => {
        if (!isOpen()) detail.showPopover();
        place(detail, button);
      };
      const hide = () => {
        if (isOpen() && pinned !== detail) detail.hidePopover();
      };
      const soon = (action, wait) => {
        clearTimeout(timer);
        timer = setTimeout(action, wait);
      };
      button.addEventListener("pointerenter", (event) => {
        if (event.pointerType === "mouse" && !pinned) soon(show, 150);
      });
      button.addEventListener("pointerleave", () => soon(hide, 200));
      detail.addEventListener("pointerenter", () => clearTimeout(timer));
      detail.addEventListener("pointerleave", () => soon(hide, 200));
      button.addEventListener("focus", () => {
        if (button.matches(":focus-visible")) show();
      });
      button.addEventListener("blur", hide);
      button.addEventListener("click", (event) => {
        clearTimeout(timer);
        if (isOpen() && pinned !== detail) {
          // The browser would close what hover or focus has opened.
          event.preventDefault();
          pinned = detail;
        } else if (!isOpen()) {
          pinned = detail;
        }
      });
      detail.addEventListener("toggle", (event) => {
        if (event.newState === "open") place(detail, button);
        else if (pinned === detail) pinned = null;
      });
    }
  }

  // Filters of a list: each select names an attribute of the rows, in which values stand between bars. What is
  // chosen stands in the address, as in #tables?verdict=differs, so that it can be sent, and the way back leads there.
  function addFilters() {
    for (const form of document.querySelectorAll("form.filters")) {
      const rows = [...document.querySelectorAll(`#${form.dataset.rows} [data-row]`)];
      const said = form.querySelector("output");
      const fields = [...form.querySelectorAll("select, input")];
      const start = `#${form.dataset.rows}?`;
      const apply = () => {
        let shown = 0;
        for (const row of rows) {
          const fits = fields.every((field) => {
            const wanted = field.value.trim();
            if (!wanted) return true;
            if (field.type === "search") return row.textContent.toLowerCase().includes(wanted.toLowerCase());
            return (row.getAttribute(`data-${field.name}`) || "").split("|").includes(wanted);
          });
          row.hidden = !fits;
          shown += fits;
        }
        for (const group of document.querySelectorAll(`#${form.dataset.rows} [data-group]`)) {
          group.hidden = ![...group.querySelectorAll("[data-row]")].some((row) => !row.hidden);
        }
        said.textContent = `${shown} of ${rows.length} shown`;
      };
      const write = (isTyped) => {
        const chosen = new URLSearchParams();
        for (const field of fields) if (field.value.trim()) chosen.set(field.name, field.value.trim());
        const words = chosen.toString();
        const address = location.href.replace(/#.*/, "") + (words ? start + words : "");
        // A word is one step of the way, not one for each letter.
        if (address !== location.href) history[isTyped ? "replaceState" : "pushState"](null, "", address);
      };
      const read = () => {
        const is = location.hash.startsWith(start);
        const chosen = new URLSearchParams(is ? location.hash.slice(start.length) : "");
        for (const field of fields) {
          field.value = chosen.get(field.name) || "";
          // A value that is not among those of the list leaves it without any.
          if (field.selectedIndex === -1) field.value = "";
        }
        apply();
        return is;
      };
      form.hidden = false;
      form.addEventListener("input", (event) => {
        apply();
        write(event.target.type === "search");
      });
      form.addEventListener("submit", (event) => event.preventDefault());
      form.addEventListener("reset", () => setTimeout(() => {
        apply();
        write(false);
      }));
      addEventListener("popstate", read);
      if (read()) form.scrollIntoView();
    }
  }

  // An address that names a number opens it.
  function openNamed() {
    const named = location.hash.length > 1 && document.getElementById(location.hash.slice(1));
    if (!named || !named.matches("button.number")) return;
    named.scrollIntoView({ block: "center" });
    const detail = document.getElementById(named.getAttribute("popovertarget"));
    if (detail.showPopover && !detail.matches(":popover-open")) named.click();
  }

  // A figure in the whole window: opened by its link, larger by a click, buttons or + and -, closed by Escape.
  function addZoom() {
    const links = document.querySelectorAll("a.zoom");
    if (!links.length || !window.HTMLDialogElement) return;
    const dialog = document.createElement("dialog");
    dialog.className = "zoomed";
    dialog.innerHTML = `<div tabindex="0"><img alt=""></div><form method="dialog">
      <button type="button">Smaller</button> <button type="button">Larger</button> <button>Close</button></form>`;
    document.body.append(dialog);
    const place = dialog.querySelector("div");
    const image = dialog.querySelector("img");
    const [smaller, larger] = dialog.querySelectorAll("button");
    const most = 16;
    let factor = 1;
    // What stands at a point of the window, in shares of it, stays there.
    function scale(wanted, x = 0.5, y = 0.5) {
      const to = Math.min(Math.max(wanted, 1), most);
      const left = (place.scrollLeft + x * place.clientWidth) * (to / factor) - x * place.clientWidth;
      const top = (place.scrollTop + y * place.clientHeight) * (to / factor) - y * place.clientHeight;
      factor = to;
      image.style.width = image.style.height = `${100 * factor}%`;
      smaller.disabled = factor === 1;
      larger.disabled = factor === most;
      place.scrollTo(left, top);
    }
    smaller.addEventListener("click", () => scale(factor / 2));
    larger.addEventListener("click", () => scale(factor * 2));
    image.addEventListener("click", (event) => {
      scale(factor < most ? factor * 2 : 1, event.clientX / place.clientWidth, event.clientY / place.clientHeight);
    });
    dialog.addEventListener("keydown", (event) => {
      if (event.key === "+" || event.key === "=") scale(factor * 2);
      else if (event.key === "-") scale(factor / 2);
    });
    for (const link of links) {
      link.addEventListener("click", (event) => {
        if (event.ctrlKey || event.metaKey || event.shiftKey) return;
        event.preventDefault();
        const shown = link.querySelector("img");
        image.src = shown.src;
        image.alt = shown.alt;
        dialog.setAttribute("aria-label", shown.alt);
        dialog.showModal();
        scale(1);
      });
    }
  }

  addEventListener("beforeprint", () => {
    for (const details of document.querySelectorAll("details")) details.open = true;
  });
  document.addEventListener("DOMContentLoaded", () => {
    addTheme();
    addDetails();
    addFilters();
    addZoom();
    openNamed();
    addEventListener("hashchange", openNamed);
  });
})();
