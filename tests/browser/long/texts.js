// Every text that is seen, and what is only read aloud.
() => {
  const found = [];
  const isSeen = (one) => one.checkVisibility({visibilityProperty: true});
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const parent = walker.currentNode.parentElement, text = walker.currentNode.textContent.trim();
    if (text && !parent.closest("script, style, .q-icon, #events") && isSeen(parent)) found.push(text);
  }
  for (const one of document.querySelectorAll("[aria-label], [title], [placeholder]"))
    if (isSeen(one)) for (const name of ["aria-label", "title", "placeholder"]) {
      const text = one.getAttribute(name);
      if (text) found.push(text);
    }
  return found;
}
