/** Copies the text of a text area. */

/** Copy a text. Frames may lack clipboard permission, which the older method does not need. If both fail, the text stays selected. */
export async function copyText(area: HTMLTextAreaElement): Promise<boolean> {
  if (
    await navigator.clipboard?.writeText(area.value).then(
      () => true,
      () => false,
    )
  )
    return true;
  area.focus();
  area.select();
  return document.execCommand("copy");
}
