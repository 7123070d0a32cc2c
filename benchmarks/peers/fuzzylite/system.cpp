// One fuzzy system of 49 rules in fuzzylite, as a separate program: nothing of hexservo is linked with it.
//
// Two inputs with seven bells each, product for "and", constants weighted by their rule's strength (Takagi-Sugeno of
// order zero, weighted average). Every rule has its own constant, because the adaptation gives each its own
// weight. The engine is built once; setting the inputs, `Engine::process` and reading the output are timed.
//
// parameters: width and slope of the bells, 49 weights, row by row (row: term of u); row: u, u-dot; answer: the output
#include <fl/Headers.h>

#include "../serve.hpp"

namespace {

constexpr int kTerms = 7;
const char* const kNames[kTerms] = {"NB", "NM", "NS", "ZE", "PS", "PM", "PB"};

fl::InputVariable* add_input(fl::Engine& engine, const std::string& name, double width, double slope) {
  auto* input = new fl::InputVariable(name, -1.0, 1.0);  // the engine owns it
  for (int k = 0; k < kTerms; ++k) input->addTerm(new fl::Bell(kNames[k], (k - 3) / 3.0, width, slope));
  engine.addInputVariable(input);
  return input;
}

}  // namespace

int main() {
  const std::vector<double> parameters = peers::read_numbers(2 + kTerms * kTerms);
  fl::fuzzylite::setMachEps(0.0);  // else rules weaker than 1e-6 are left out: less work, another answer
  fl::Engine engine("system");
  fl::InputVariable* u = add_input(engine, "u", parameters[0], parameters[1]);
  fl::InputVariable* rate = add_input(engine, "rate", parameters[0], parameters[1]);

  auto* output = new fl::OutputVariable("tau", -1e6, 1e6);
  output->setAggregation(fl::null);
  output->setDefuzzifier(new fl::WeightedAverage("TakagiSugeno"));
  engine.addOutputVariable(output);

  auto* rules = new fl::RuleBlock("rules");
  rules->setConjunction(new fl::AlgebraicProduct);
  rules->setDisjunction(fl::null);
  rules->setImplication(fl::null);
  rules->setActivation(new fl::General);
  engine.addRuleBlock(rules);
  for (int row = 0; row < kTerms; ++row) {
    for (int column = 0; column < kTerms; ++column) {
      const std::string name = std::string(kNames[row]) + kNames[column];
      output->addTerm(new fl::Constant(name, parameters[static_cast<std::size_t>(2 + row * kTerms + column)]));
      rules->addRule(fl::Rule::parse(
          "if u is " + std::string(kNames[row]) + " and rate is " + kNames[column] + " then tau is " + name, &engine));
    }
  }
  std::string problem;
  if (!engine.isReady(&problem)) {
    std::cerr << problem << '\n';
    return 1;
  }

  return peers::serve(
      "fuzzylite " + fl::fuzzylite::version(), 2, 1, [] {},
      [&](const double* row, double* out) {
        u->setValue(row[0]);
        rate->setValue(row[1]);
        engine.process();
        out[0] = output->getValue();
      });
}
