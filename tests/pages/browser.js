// What is wrong with the page at this width, with all that folds unfolded: what leaves it, and texts that lie on one another.
() => {
  const found = [], wide = document.documentElement.clientWidth, folded = [...document.querySelectorAll("details:not([open])")];
  for (const e of folded) e.open = true; // what is folded has boxes too, one upon another
  if (document.documentElement.scrollWidth > wide) found.push(`the page is ${document.documentElement.scrollWidth} px wide`);
  for (const e of document.body.querySelectorAll("*")) {
    const box = e.getBoundingClientRect();
    if (box.right > wide + 1 && !e.closest(".box")) found.push(`${e.tagName} ${e.className} ends at ${Math.round(box.right)} px`);
  }
  const boxes = [], range = document.createRange(), walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    if (!walk.currentNode.data.trim()) continue;
    range.selectNodeContents(walk.currentNode);
    for (const r of range.getClientRects())
      if (r.width > 1 && r.height > 1) boxes.push({ top: r.top + 3, bottom: r.bottom - 3, left: r.left + 1, right: r.right - 1, text: walk.currentNode.data.trim() });
  }
  boxes.sort((a, b) => a.top - b.top);
  for (let i = 0; i < boxes.length; i++)
    for (let k = i + 1; k < boxes.length && boxes[k].top < boxes[i].bottom; k++)
      if (boxes[i].left < boxes[k].right && boxes[k].left < boxes[i].right) found.push(`"${boxes[i].text}" on "${boxes[k].text}"`);
  for (const img of document.images) if (!img.complete || !img.naturalWidth) found.push(`no picture: ${img.alt}`);
  for (const e of folded) e.open = false;
  return found;
}
