"use strict";
// The search. Its index is a script beside this folder, loaded when it is first needed: a page that was opened
// from a file may not fetch data.
(function () {
  const root = new URL("../", document.currentScript.src);
  const input = document.getElementById("search");
  const list = document.getElementById("search-results");
  const status = document.getElementById("search-status");
  const page = document.getElementById("found");
  if (!input) return;
  const MOST = 10, MOST_ON_PAGE = 200;
  let loading = null, shown = [], chosen = -1;

  function plain(text) {
    return text.normalize("NFD").replace(/[\u0300-\u036f]/g, "").toLowerCase();
  }

  function load() {
    loading = loading || new Promise(function (done, failed) {
      const script = document.createElement("script");
      script.src = new URL("search-index.js", root).href;
      script.onload = function () { done(prepared(window.hidentIndex)); };
      script.onerror = function () { loading = null; failed(new Error("search-index.js is not there")); };
      document.head.append(script);
    });
    return loading;
  }

  function prepared(index) {
    return index.passages.map(function (passage) {
      const [number, anchor, title, text] = passage;
      const [path, on, section] = index.pages[number];
      // A page is found by its name too, such as that of a configuration.
      const name = plain(path.slice(path.lastIndexOf("/") + 1).replace(/\.html$/, ""));
      return {
        href: new URL(path, root).href + (anchor ? "#" + encodeURIComponent(anchor) : ""),
        title, text, on, section, isPage: !anchor,
        name: anchor ? "" : name, words: plain(title), page: plain(on), body: plain(text),
      };
    });
  }

  // Each word must be the beginning of one in the title or in the text; titles count most.
  function search(entries, query) {
    const words = plain(query).split(/\s+/).filter(Boolean);
    if (!words.length) return [];
    const patterns = words.map(function (word) {
      const escaped = word.replace(/[.*+?^${}()|[\]\\]/g, "\\$&");
      return { begins: new RegExp("(^|[^a-z0-9])" + escaped), whole: new RegExp("(^|[^a-z0-9_])" + escaped + "($|[^a-z0-9_])") };
    });
    const found = [];
    for (const entry of entries) {
      let score = 0;
      for (const pattern of patterns) {
        const titled = [entry.words, entry.name].filter(function (title) { return pattern.begins.test(title); });
        if (titled.length) score += titled.some(function (title) { return pattern.whole.test(title); }) ? 20 : 10;
        else if (pattern.begins.test(entry.page)) score += 4;
        else if (pattern.begins.test(entry.body)) score += pattern.whole.test(entry.body) ? 2 : 1;
        else { score = 0; break; }
      }
      if (!score) continue;
      if ([entry.words, entry.name].includes(words.join(" "))) score += 40;
      if (entry.isPage) score += 3;
      found.push({ entry, score });
    }
    // Stable: of equal ones the first on the site.
    found.sort(function (a, b) { return b.score - a.score; });
    return found.map(function (one) { return one.entry; });
  }

  // The text around the first word that was found, with all words marked.
  function excerpt(entry, query) {
    const words = plain(query).split(/\s+/).filter(Boolean);
    const at = Math.max(0, Math.min(...words.map(function (word) {
      const where = entry.body.indexOf(word);
      return where < 0 ? Infinity : where;
    })));
    // Without its accents a text is as long as with them only if it had none: then it begins at the start.
    const near = isFinite(at) && entry.body.length === entry.text.length ? at - 60 : 0;
    const start = near > 0 ? Math.min(entry.text.indexOf(" ", near) + 1, at) : 0;
    const cut = entry.text.length > start + 180 ? entry.text.lastIndexOf(" ", start + 180) : entry.text.length;
    const end = cut > start ? cut : start + 180;
    return marked((start ? "… " : "") + entry.text.slice(start, end) + (end < entry.text.length ? " …" : ""), words);
  }

  function marked(text, words) {
    const span = document.createElement("span");
    const escaped = words.map(function (word) { return word.replace(/[.*+?^${}()|[\]\\]/g, "\\$&"); });
    for (const [i, piece] of text.split(new RegExp("(" + escaped.join("|") + ")", "i")).entries()) {
      if (i % 2) {
        const mark = document.createElement("mark");
        mark.textContent = piece;
        span.append(mark);
      } else span.append(piece);
    }
    return span;
  }

  function told(entry, query, into) {
    const title = document.createElement("span");
    title.className = "title";
    title.textContent = entry.title;
    const where = document.createElement("span");
    where.className = "where";
    where.textContent = entry.isPage && entry.on === entry.title ? entry.section : entry.section + " › " + entry.on;
    const words = excerpt(entry, query);
    words.className = "excerpt";
    into.append(title, " ", where, words);
  }

  function show(results, query) {
    shown = results.slice(0, MOST);
    chosen = -1;
    list.replaceChildren(...shown.map(function (entry, i) {
      const option = document.createElement("li");
      option.id = "search-result-" + i;
      option.setAttribute("role", "option");
      option.setAttribute("aria-selected", "false");
      told(entry, query, option);
      option.addEventListener("mousedown", function (event) { event.preventDefault(); });
      option.addEventListener("click", function () { go(entry); });
      return option;
    }));
    open(shown.length > 0);
    const more = results.length - shown.length;
    say(!query.trim() ? "" : !results.length ? "Nothing was found." : results.length + (results.length === 1 ? " result" : " results")
      + (more > 0 ? ", " + shown.length + " shown: press Enter for all" : "") + ".");
  }

  function open(is) {
    list.hidden = !is;
    input.setAttribute("aria-expanded", String(is));
    if (!is) input.removeAttribute("aria-activedescendant");
  }

  function say(words) { status.textContent = words; }

  function go(entry) {
    open(false);
    location.href = entry.href;
  }

  function choose(number) {
    const options = list.children;
    if (!options.length) return;
    if (chosen >= 0) options[chosen].setAttribute("aria-selected", "false");
    chosen = (number + options.length) % options.length;
    options[chosen].setAttribute("aria-selected", "true");
    options[chosen].scrollIntoView({ block: "nearest" });
    input.setAttribute("aria-activedescendant", options[chosen].id);
  }

  function renew() {
    const query = input.value;
    load().then(
      function (entries) { if (query === input.value) show(search(entries, query), query); },
      function (error) { say(error.message); }
    );
  }

  input.addEventListener("focus", function () { load().catch(function (error) { say(error.message); }); });
  input.addEventListener("input", renew);
  input.addEventListener("blur", function () { open(false); });
  input.addEventListener("keydown", function (event) {
    if (event.key === "ArrowDown" || event.key === "ArrowUp") {
      event.preventDefault();
      if (list.hidden && input.value.trim()) renew();
      else choose(event.key === "ArrowDown" ? chosen + 1 : (chosen < 0 ? 0 : chosen) - 1);
    } else if (event.key === "Enter" && chosen >= 0 && !list.hidden) {
      event.preventDefault();
      go(shown[chosen]);
    } else if (event.key === "Escape") {
      event.preventDefault();
      if (!list.hidden) open(false);
      else if (input.value) { input.value = ""; say(""); }
      else input.blur();
    }
  });
  document.addEventListener("keydown", function (event) {
    const within = event.target.closest && event.target.closest("input, textarea, select, [contenteditable]");
    if (event.key === "/" && !within && !event.ctrlKey && !event.metaKey && !event.altKey) {
      event.preventDefault();
      input.focus();
      input.select();
    }
  });

  // The page of the search shows all results.
  const query = page && new URLSearchParams(location.search).get("q");
  if (query) {
    input.value = query;
    load().then(function (entries) {
      const results = search(entries, query);
      page.hidden = false;
      document.getElementById("found-heading").textContent =
        results.length ? results.length + (results.length === 1 ? " result" : " results") + " for “" + query + "”" : "Nothing was found for “" + query + "”";
      page.querySelector("ol").replaceChildren(...results.slice(0, MOST_ON_PAGE).map(function (entry) {
        const item = document.createElement("li");
        const link = document.createElement("a");
        link.href = entry.href;
        told(entry, query, link);
        item.append(link);
        return item;
      }));
    }, function (error) { say(error.message); });
  }
})();
