// Formulas are MathML, which browsers show by themselves. Where MathJax can be loaded, it sets them again from TeX.
window.MathJax = {
  tex: { inlineMath: [["\\(", "\\)"]], displayMath: [["\\[", "\\]"]] },
  options: { ignoreHtmlClass: ".*", processHtmlClass: "arithmatex" },
  startup: {
    pageReady() {
      for (const formula of document.querySelectorAll(".arithmatex[data-tex]")) {
        formula.textContent = formula.dataset.tex;
      }
      return MathJax.startup.defaultPageReady();
    },
  },
};
