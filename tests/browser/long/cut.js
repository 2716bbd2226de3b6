// Texts that are wider or higher than their boxes, labels of fields too. What is scrolled is not.
() => [...document.querySelectorAll(".q-field__label")].filter((one) => one.scrollWidth > one.clientWidth + 1)
  .map((one) => one.textContent.trim()).concat([...document.querySelectorAll("button, .field, .banner *, .card *, .place *, #bar *")]
  .filter((one) => one.checkVisibility({visibilityProperty: true})
    && !one.closest(".q-icon, .q-field, .q-uploader, #events, canvas, svg, .unseen")
    && [...one.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim()))
  .filter((one) => {
    const range = document.createRange();
    range.selectNodeContents(one);
    const text = range.getBoundingClientRect();
    for (let up = one; up && up.id !== "stage"; up = up.parentElement) {
      const style = getComputedStyle(up), box = up.getBoundingClientRect();
      if (style.overflowX !== "visible" && (text.right > box.right + 1 || text.left < box.left - 1)) return true;
      if (/auto|scroll/.test(style.overflowY)) return false;
      if (style.overflowY === "hidden" && text.height > 1 && text.bottom > box.bottom + 1) return true;
    }
    return false;
  }).map((one) => one.textContent.trim()))
