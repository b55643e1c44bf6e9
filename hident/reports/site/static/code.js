"use strict";
// The table of contents is folded where it would push the text off the screen.
if (window.matchMedia("(max-width: 60rem)").matches)
  for (const details of document.querySelectorAll(".contents details")) details.open = false;

// What scrolls must be reached by keyboard, and what does not should not be in the way.
if (window.ResizeObserver) {
  const watched = new ResizeObserver(function (seen) {
    for (const { target } of seen) {
      if (target.scrollWidth > target.clientWidth) target.tabIndex = 0;
      else target.removeAttribute("tabindex");
    }
  });
  for (const block of document.querySelectorAll("pre")) watched.observe(block);
}

// A button on each block of code that copies it; where the browser cannot copy there is none.
(function () {
  if (!navigator.clipboard && !document.queryCommandSupported) return;

  function copied(text) {
    if (navigator.clipboard && window.isSecureContext) return navigator.clipboard.writeText(text);
    // A page that was opened from a file is no secure context everywhere.
    const area = document.createElement("textarea");
    area.value = text;
    area.style.position = "fixed";
    area.style.opacity = "0";
    document.body.append(area);
    area.select();
    const done = document.execCommand("copy");
    area.remove();
    return done ? Promise.resolve() : Promise.reject(new Error("not copied"));
  }

  // What was typed at a prompt, without the prompts and the answers.
  function typed(code) {
    if (!code.querySelector(".prompt")) return code.textContent;
    const copy = code.cloneNode(true);
    for (const other of copy.querySelectorAll(".prompt, .output")) other.remove();
    return copy.textContent.replace(/\n{2,}/g, "\n");
  }

  for (const code of document.querySelectorAll("pre > code")) {
    const button = document.createElement("button");
    button.type = "button";
    button.className = "copy";
    button.textContent = "Copy";
    button.addEventListener("click", function () {
      copied(typed(code)).then(
        function () { button.textContent = "Copied"; },
        function () { button.textContent = "Press Ctrl+C"; }
      ).then(function () {
        setTimeout(function () { button.textContent = "Copy"; }, 2000);
      });
    });
    const around = document.createElement("div");
    around.className = "code";
    code.parentElement.replaceWith(around);
    around.append(code.parentElement, button);
  }
})();
