// The theme adds buttons beside code and boxes around wide tables while one reads. The buttons are
// no landmark of the page, and a box that scrolls must be reachable with the keyboard.
new MutationObserver(() => {
  for (const buttons of document.querySelectorAll("nav.md-code__nav")) buttons.setAttribute("role", "none");
  for (const box of document.querySelectorAll(".md-typeset__scrollwrap, .md-typeset pre > code")) box.tabIndex = 0;
}).observe(document.documentElement, { childList: true, subtree: true });
