// What every page has: elements, a failure that is said, and what is shown in its address.

const find = (id) => document.getElementById(id);

function failed(error) {
  find("failure").textContent = error && error.message ? error.message : String(error);
  document.body.classList.add("failed");
}

// Words of the address after the #, a moment after the last change: words() gives them.
let writing;
function remember(words) {
  clearTimeout(writing);
  writing = setTimeout(() => {
    try {
      history.replaceState(null, "", `#${new URLSearchParams(words())}`);
    } catch {
      // a page from a file may not always change its own address
    }
  }, 300);
}
