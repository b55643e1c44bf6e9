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

  // Words that every text has: a search for others too does without them.
  const EMPTY = new Set(("a about an and are as at be by can do does for from how i in is it my of on or that the"
    + " there this to was what when where which why with").split(" "));

  function plain(text) {
    return text.normalize("NFD").replace(/[\u0300-\u036f]/g, "").toLowerCase();
  }

  // A word in one spelling, whether British or American. Of two words that become one, both are found.
  function spelled(word) {
    if (word.length < 4) return word;
    return word
      .replace(/is(?=(e|ed|er|ers|es|ing|able|ation|ations)$)/, "iz")
      .replace(/ys(?=(e|ed|er|ers|ing)$)/, "yz")
      .replace(/^([a-z]{3,})our/, "$1or")
      .replace(/(cent|met|fib|lit)(er|re?)(?=(s|ed|ing)?$)/, "$1r")
      .replace(/ll(?=(ed|er|ers|ing)$)/, "l")
      .replace(/logue(?=s?$)/, "log")
      .replace(/^grey/, "gray");
  }

  // The same for its singular and its plural.
  function single(word) {
    if (word.length < 4) return word;
    return word
      .replace(/(ys|thes|bas)es$/, "$1is")
      .replace(/(ices|ix|ex)$/, "ic")
      .replace(/ies$/, "y")
      .replace(/(ch|sh|ss|x|z)es$/, "$1")
      .replace(/([^aius])s$/, "$1");
  }

  const foldedWords = new Map();
  function folded(word) {
    if (!foldedWords.has(word)) foldedWords.set(word, single(spelled(word)));
    return foldedWords.get(word);
  }

  function field(text) {
    const words = plain(text);
    return { plain: words, folded: words.replace(/[a-z]{4,}/g, folded) };
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
        name: field(anchor ? "" : name), words: field(title), page: field(on), body: field(text),
      };
    });
  }

  function escaped(word) { return word.replace(/[.*+?^${}()|[\]\\]/g, "\\$&"); }

  // How a word is looked for: as the beginning of one, in its other spelling or number, and, if it may be an
  // abbreviation, by the words that it stands for ("SVD": singular value decomposition).
  function pattern(word, isShort) {
    const each = function (change) { return word.replace(/[a-z]{4,}/g, change); };
    const letters = single(word);
    return {
      word,
      begins: new RegExp("(?<![a-z0-9])" + escaped(word)),
      whole: new RegExp("(?<![a-z0-9_])" + escaped(word) + "(?![a-z0-9_])"),
      folded: new RegExp("(?<![a-z0-9])(?:" + escaped(each(spelled)) + "|" + escaped(each(folded)) + "(?![a-z0-9]))"),
      singly: new RegExp("(?<![a-z0-9_])" + escaped(each(folded)) + "(?![a-z0-9_])"),
      meant: isShort && /^[a-z]{3,5}$/.test(letters)
        ? new RegExp("(?<![a-z0-9])" + [...letters].map(function (letter) { return letter + "[a-z]{3,}"; }).join("[ -]")) : null,
    };
  }

  function begins(one, text) { return one.begins.test(text.plain) || one.folded.test(text.folded); }
  function isWhole(one, text) { return one.whole.test(text.plain) || one.singly.test(text.folded); }

  function apart(name) { return name.replace(/_/g, " "); }

  // Titles count most.
  function worth(one, entry) {
    const titled = [entry.words, entry.name].filter(function (title) { return begins(one, title); });
    if (titled.length) return titled.some(function (title) { return isWhole(one, title); }) ? 20 : 10;
    if (begins(one, entry.page)) return 4;
    if (begins(one, entry.body)) return isWhole(one, entry.body) ? 2 : 1;
    return one.meant && [entry.words, entry.body].some(function (text) { return one.meant.test(text.plain); }) ? 1 : 0;
  }

  // The entries that have at least so many of the words, those with most of them first.
  function ranked(entries, patterns, least) {
    const words = patterns.map(function (one) { return one.word; }).join(" ");
    const found = [];
    for (const entry of entries) {
      const worths = patterns.map(function (one) { return worth(one, entry); }).filter(Boolean);
      if (worths.length < least) continue;
      let score = worths.reduce(function (sum, one) { return sum + one; }, 0);
      // "prediction error" names prediction_error.
      if ([entry.words, entry.name].some(function (title) { return apart(title.plain) === apart(words); })) score += 40;
      if (entry.isPage) score += 3;
      found.push({ entry, score, has: worths.length });
    }
    // Stable: of equal ones the first on the site.
    found.sort(function (a, b) { return b.has - a.has || b.score - a.score; });
    return found.map(function (one) { return one.entry; });
  }

  // What is found, how it was looked for, the query that it was found by where the given one finds nothing, and
  // whether it has some of the words only.
  function search(entries, query) {
    const all = query.split(/\s+/).filter(Boolean);
    const telling = all.filter(function (word) { return !EMPTY.has(plain(word).replace(/[?.,!]+$/, "")); });
    const given = (telling.length ? telling : all).map(function (word) { return word.replace(/(?<=[a-z])[?.,!]+$/i, ""); });
    if (!given.length) return { results: [], patterns: [], instead: "", some: false };
    const first = given.map(function (word) { return pattern(plain(word), /^([A-Z]{3,5}s?|[b-df-hj-np-tv-xz]{3,5})$/.test(word)); });
    const results = ranked(entries, first, first.length);
    if (results.length) return { results, patterns: first, instead: "", some: false };

    const words = given.slice();
    const patterns = first.map(function (one, i) {
      const stands = function (other) { return entries.some(function (entry) { return worth(other, entry); }); };
      if (stands(one)) return one;
      const short = pattern(one.word, true);
      if (short.meant && stands(short)) return short;
      const near = nearest(entries, one.word);
      if (!near) return one;
      words[i] = near;
      return pattern(plain(near), false);
    });
    const instead = words.join(" ") === given.join(" ") ? "" : words.join(" ");
    for (let least = patterns.length; least; least--) {
      const mended = ranked(entries, patterns, least);
      if (mended.length) return { results: mended, patterns, instead, some: least < patterns.length };
    }
    return { results: [], patterns: first, instead: "", some: false };
  }

  // Whether two words differ by one letter that is changed, left out or added, or by two that are exchanged.
  function isNear(a, b) {
    if (Math.abs(a.length - b.length) > 1) return false;
    let i = 0;
    while (i < a.length && a[i] === b[i]) i++;
    if (a.length > b.length) return a.slice(i + 1) === b.slice(i);
    if (a.length < b.length) return a.slice(i) === b.slice(i + 1);
    return a.slice(i + 1) === b.slice(i + 1)
      || (a[i] === b[i + 1] && a[i + 1] === b[i] && a.slice(i + 2) === b.slice(i + 2));
  }

  // Of the words of the site that are nearest to one that it does not have, the most frequent; none to a number.
  let vocabulary = null;
  function nearest(entries, word) {
    if (!/^[a-z]{4,}$/.test(word)) return "";
    if (!vocabulary) {
      vocabulary = new Map();
      for (const entry of entries) {
        for (const written of (entry.title + " " + entry.text).match(/[\p{L}]{4,}/gu) || []) {
          const key = folded(plain(written));
          const known = vocabulary.get(key);
          if (known) known.times++;
          else vocabulary.set(key, { written, times: 1 });
        }
      }
    }
    const sought = folded(word);
    let best = null;
    for (const [key, known] of vocabulary) {
      if (!isNear(sought, key)) continue;
      // A first letter is seldom wrong.
      const rank = known.times + (key[0] === sought[0] ? 1e6 : 0);
      if (!best || rank > best.rank) best = { rank, written: known.written };
    }
    return best ? best.written : "";
  }

  // The words of a text by which it was found, as one expression.
  function forms(text, patterns) {
    const words = new Set(text.plain.match(/[a-z]{2,}/g));
    const found = patterns.flatMap(function (one) {
      const others = [...words].filter(function (word) { return one.folded.test(folded(word)); });
      const meant = one.meant ? text.plain.match(one.meant) : null;
      return [one.word, ...others, ...(meant ? [meant[0]] : [])];
    });
    found.sort(function (a, b) { return b.length - a.length; });
    return new RegExp("(?<![a-z0-9])(" + found.map(escaped).join("|") + ")", "i");
  }

  // The text around the first word that was found, with all words marked.
  function excerpt(entry, patterns) {
    const sought = forms(entry.body, patterns);
    const at = entry.body.plain.search(sought);
    // Places are those of the text itself only if it is as long without its accents.
    const near = at >= 0 && entry.body.plain.length === entry.text.length ? at - 60 : 0;
    const start = near > 0 ? Math.min(entry.text.indexOf(" ", near) + 1, at) : 0;
    const cut = entry.text.length > start + 180 ? entry.text.lastIndexOf(" ", start + 180) : entry.text.length;
    const end = cut > start ? cut : start + 180;
    return marked((start ? "… " : "") + entry.text.slice(start, end) + (end < entry.text.length ? " …" : ""), sought);
  }

  function marked(text, sought) {
    const span = document.createElement("span");
    for (const [i, piece] of text.split(sought).entries()) {
      if (i % 2) {
        const mark = document.createElement("mark");
        mark.textContent = piece;
        span.append(mark);
      } else span.append(piece);
    }
    return span;
  }

  // What is said of a search, without how many results it has.
  function remark(found, query) {
    if (!found.results.length) return "Nothing was found for “" + query + "”";
    return (found.instead ? "Nothing was found for “" + query + "”. Did you mean “" + found.instead + "”? " : "")
      + (found.some ? "No passage has all of these words: those with some. " : "");
  }

  function counted(results) { return results.length + (results.length === 1 ? " result" : " results"); }

  function told(entry, patterns, into) {
    const title = document.createElement("span");
    title.className = "title";
    title.textContent = entry.title;
    const where = document.createElement("span");
    where.className = "where";
    where.textContent = entry.isPage && entry.on === entry.title ? entry.section : entry.section + " › " + entry.on;
    const words = excerpt(entry, patterns);
    words.className = "excerpt";
    into.append(title, " ", where, words);
  }

  function show(found, query) {
    const results = found.results.slice(0, MOST);
    shown = results.map(function (entry) {
      return { tell: function (option) { told(entry, found.patterns, option); }, take: function () { go(entry); } };
    });
    if (found.instead || (found.some && results.length)) {
      shown.unshift({
        tell: function (option) { option.textContent = remark(found, query).trim(); },
        take: function () { if (found.instead) { input.value = found.instead; renew(); } },
      });
    }
    chosen = -1;
    list.replaceChildren(...shown.map(function (one, i) {
      const option = document.createElement("li");
      option.id = "search-result-" + i;
      option.setAttribute("role", "option");
      option.setAttribute("aria-selected", "false");
      one.tell(option);
      option.addEventListener("mousedown", function (event) { event.preventDefault(); });
      option.addEventListener("click", one.take);
      return option;
    }));
    open(shown.length > 0);
    const more = found.results.length - results.length;
    say(!query.trim() ? "" : !results.length ? "Nothing was found." : remark(found, query) + counted(found.results)
      + (more > 0 ? ", " + results.length + " shown: press Enter for all" : "") + ".");
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
      shown[chosen].take();
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
      const found = search(entries, query);
      page.hidden = false;
      document.getElementById("found-heading").textContent = remark(found, query)
        + (found.results.length ? counted(found.results) + " for “" + (found.instead || query) + "”" : "");
      page.querySelector("ol").replaceChildren(...found.results.slice(0, MOST_ON_PAGE).map(function (entry) {
        const item = document.createElement("li");
        const link = document.createElement("a");
        link.href = entry.href;
        told(entry, found.patterns, link);
        item.append(link);
        return item;
      }));
    }, function (error) { say(error.message); });
  }
})();
