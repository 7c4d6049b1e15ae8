/* Ages of times on a page, as of now; what is old is marked. */
"use strict";

for (const time of document.querySelectorAll("time[data-old-after-nights]")) {
  const days = (Date.now() - Date.parse(time.dateTime)) / 86400000;
  const hours = Math.floor(24 * days);
  const age = hours < 1 ? "now" : hours < 48 ? `${hours} h ago` : `${Math.floor(days)} days ago`;
  const words = document.createElement("span");
  words.textContent = `(${age})`;
  time.append(" ", words);
  time.classList.toggle("old", days > Number(time.dataset.oldAfterNights));
}
