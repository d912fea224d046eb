// The report: everything is in the page.

async function start() {
  try {
    window.page = new Page(await flightData());
    document.documentElement.dataset.ready = "true";
  } catch (error) {
    byId("notice").textContent = typeof DecompressionStream === "undefined"
      ? "This browser cannot unpack the page. Playback needs Chrome 80, Firefox 113, Safari 16.4 or newer; the figures are beside the page, as PNG."
      : `Playback failed: ${error.message}. The figures are beside the page, as PNG.`;
    console.error(error);
  }
}

start();
