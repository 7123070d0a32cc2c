# Installs the C++ package, builds examples/ against it as a project of its own, and runs what it built.
#   cmake -DSOURCE=... -DBUILD=... -DGENERATOR=... [-D<variables that both builds must share>=...] -P installed.cmake
set(work "${BUILD}/installed")
file(REMOVE_RECURSE "${work}")

function(run)
  execute_process(COMMAND ${ARGV} RESULT_VARIABLE code OUTPUT_VARIABLE output ERROR_VARIABLE output)
  message("${output}")
  if(NOT code EQUAL 0)
    message(FATAL_ERROR "failed with ${code}: ${ARGV}")
  endif()
endfunction()

# Moved after the installation: nothing in the package may depend on where it was put, or on the source tree.
run("${CMAKE_COMMAND}" --install "${BUILD}" --prefix "${work}/first")
file(RENAME "${work}/first" "${work}/prefix")
file(COPY "${SOURCE}/examples" DESTINATION "${work}")

file(GLOB_RECURSE package_files "${work}/prefix/*.cmake")
foreach(file IN LISTS package_files)
  file(READ "${file}" text)
  foreach(path "${SOURCE}" "${work}")
    string(FIND "${text}" "${path}" found)
    if(NOT found EQUAL -1)
      message(FATAL_ERROR "${file} names ${path}")
    endif()
  endforeach()
endforeach()

set(shared "-DCMAKE_CXX_COMPILER=${CXX_COMPILER}" "-DCMAKE_BUILD_TYPE=${BUILD_TYPE}" "-DEigen3_DIR=${EIGEN3_DIR}"
           "-DCMAKE_CXX_FLAGS_${BUILD_TYPE_UPPER}=${CXX_FLAGS_BUILD_TYPE}" "-DCMAKE_PREFIX_PATH=${work}/prefix")
set(warnings "-Wall -Wextra -Werror")
run("${CMAKE_COMMAND}" -S "${work}/examples" -B "${work}/build" -G "${GENERATOR}" ${shared}
    "-DCMAKE_CXX_FLAGS=${CXX_FLAGS} ${warnings}")
run("${CMAKE_COMMAND}" --build "${work}/build")
run("${work}/build/servo" 1.0)

# A program in C99 through the C interface; it needs neither a C++ compiler nor Eigen.
file(COPY "${SOURCE}/tests/python/c_client.c" DESTINATION "${work}/c")
file(WRITE "${work}/c/CMakeLists.txt"
     "cmake_minimum_required(VERSION 3.22)\nproject(c_client LANGUAGES C)\nfind_package(hexservo REQUIRED COMPONENTS c)\n"
     "add_executable(c_client c_client.c)\ntarget_link_libraries(c_client PRIVATE hexservo::c)\n")
run("${CMAKE_COMMAND}" -S "${work}/c" -B "${work}/c/build" -G "${GENERATOR}" "-DCMAKE_BUILD_TYPE=${BUILD_TYPE}"
    -DCMAKE_DISABLE_FIND_PACKAGE_Eigen3=ON "-DCMAKE_PREFIX_PATH=${work}/prefix"
    "-DCMAKE_C_FLAGS=-std=c99 -pedantic -Wall -Wextra -Werror"
    "-DCMAKE_C_FLAGS_${BUILD_TYPE_UPPER}=${CXX_FLAGS_BUILD_TYPE}")
run("${CMAKE_COMMAND}" --build "${work}/c/build")
file(WRITE "${work}/c/lines" "simulation.duration 0.01\n"
     "target.initial_features 100 100 -100 100 -100 -100 100 -100\n"
     "target.desired_features 110 110 -110 110 -110 -110 110 -110\n")
execute_process(COMMAND "${work}/c/build/c_client" 10 INPUT_FILE "${work}/c/lines" RESULT_VARIABLE code
                OUTPUT_VARIABLE output ERROR_VARIABLE output)
if(NOT code EQUAL 0 OR NOT output MATCHES "^outcome completed\n")
  message(FATAL_ERROR "c_client: expected a completed run, got ${code}:\n${output}")
endif()

# The same where the C++ library is wanted only if Eigen is there.
file(COPY "${work}/c/CMakeLists.txt" "${work}/c/c_client.c" DESTINATION "${work}/optional")
file(READ "${work}/optional/CMakeLists.txt" text)
string(REPLACE "COMPONENTS c)" "COMPONENTS c OPTIONAL_COMPONENTS core)\nif(hexservo_core_FOUND)\n  message(FATAL_ERROR core)\nendif()" text
       "${text}")
file(WRITE "${work}/optional/CMakeLists.txt" "${text}")
run("${CMAKE_COMMAND}" -S "${work}/optional" -B "${work}/optional/build" -G "${GENERATOR}"
    -DCMAKE_DISABLE_FIND_PACKAGE_Eigen3=ON "-DCMAKE_PREFIX_PATH=${work}/prefix")

# The memory layout is part of the interface: other instruction-set flags must not link.
if(PROCESSOR MATCHES "^(x86_64|AMD64|amd64)$" AND NOT CXX_FLAGS MATCHES "-m(arch|avx)")
  file(WRITE "${work}/other_flags/CMakeLists.txt"
       "cmake_minimum_required(VERSION 3.22)\nproject(other_flags LANGUAGES CXX)\nfind_package(hexservo REQUIRED)\n"
       "add_executable(tick tick.cpp)\nadd_executable(run run.cpp)\n"
       "target_link_libraries(tick PRIVATE hexservo::core)\ntarget_link_libraries(run PRIVATE hexservo::core)\n")
  file(WRITE "${work}/other_flags/tick.cpp"
       "#include <hexservo/controller.hpp>\n"
       "int main() {\n"
       "  const auto gains = hexservo::controller_gains<hexservo::Hybrid>({}, 1e-3);\n"
       "  hexservo::ControllerState<hexservo::Hybrid> state(gains);\n"
       "  return state.last_pose.position(0) > 0.0;\n"
       "}\n")
  file(WRITE "${work}/other_flags/run.cpp"
       "#include <hexservo/simulation.hpp>\n"
       "int main() { return hexservo::simulate({}).time.size() > 0; }\n")
  # A program with other flags than the library's is refused, in words that tell why.
  function(expect_refusal program flags message)
    string(MAKE_C_IDENTIFIER "${program} ${flags}" name)
    run("${CMAKE_COMMAND}" -S "${work}/other_flags" -B "${work}/other_flags/${name}" -G "${GENERATOR}" ${shared}
        "-DCMAKE_CXX_FLAGS=${CXX_FLAGS} ${flags}")
    execute_process(COMMAND "${CMAKE_COMMAND}" --build "${work}/other_flags/${name}" --target ${program}
                    RESULT_VARIABLE code
                    OUTPUT_VARIABLE output ERROR_VARIABLE output)
    if(code EQUAL 0 OR NOT output MATCHES "${message}")
      message(FATAL_ERROR "${program} ${flags}: expected \"${message}\", got ${code}:\n${output}")
    endif()
  endfunction()
  expect_refusal(tick "-mavx" "library_was_built_with_other_flags")
  expect_refusal(run "-mavx" "library_was_built_with_other_flags")
  foreach(flag EIGEN_MAX_STATIC_ALIGN_BYTES=0 EIGEN_DONT_ALIGN_STATICALLY EIGEN_DEFAULT_TO_ROW_MAJOR _GLIBCXX_DEBUG)
    expect_refusal(tick "-D${flag}" "library_was_built_with_other_flags")
  endforeach()
  # Inline functions of the headers are shared with the library: nothing may remove their checks for NaN.
  expect_refusal(tick "-ffast-math -Wfatal-errors" "compile without -ffast-math")
endif()
